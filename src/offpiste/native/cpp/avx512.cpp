/* For x86-64 processors with AVX-512. */
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx512f,avx512vl,avx512dq,fma"))), apply_to = function)
#else
#pragma GCC target("avx512f,avx512vl,avx512dq,fma")
#endif
#define OFFPISTE_WIDTH 16
#include "kernels.h"
#ifdef __clang__
#pragma clang attribute pop
#endif
