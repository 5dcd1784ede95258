"""OpenCL C sources, shipped as the package cloudtomo_cl.kernels."""
