"""OpenCL devices, the structs that host and kernels share, fixed-point sums."""
