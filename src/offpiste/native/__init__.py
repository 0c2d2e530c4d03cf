"""The compiled library for CPUs, and kernels for GPUs."""
