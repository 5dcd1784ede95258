"""3-D cloud extinction from images taken from several directions."""
