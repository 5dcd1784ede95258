"""Clouds: generated ones, those of other programs' files, and their droplets' optics."""
