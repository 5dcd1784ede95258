"""What the kernels are on a GPU: what compilers make of them without one, and the checks that run on one."""
