"""The physics once more in slow NumPy, which the kernels are tested against."""
