"""What is known and measured: grid, optics, sun, surface, sensors, images and their noise, errors of an estimate."""
