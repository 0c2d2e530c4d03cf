/* For x86-64 processors with AVX2. */
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
#pragma GCC target("avx2,fma")
#endif
#define OFFPISTE_WIDTH 8
#include "kernels.h"
#ifdef __clang__
#pragma clang attribute pop
#endif
