"""Files: netCDF, images, extinctions, phase functions, the cases of I3RC."""
