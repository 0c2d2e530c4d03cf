"""The model as one C header for C99, C++, nvcc and NVRTC, printed from the same physics as the compiled library."""
