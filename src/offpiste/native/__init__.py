"""Compiled loops on the CPU, their cache on disk, and kernels on GPUs."""
