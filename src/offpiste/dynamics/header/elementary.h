/* Elementary functions of one sample: polynomials without branches, so that GPUs need no slow path and no stack. Errors
   are below 4e-7, of tanh and atan also relative ones, of sin and cos up to 1e4. NaN gives NaN, from tanh too.

   C99, C++ (g++, clang), CUDA (nvcc, NVRTC). offpiste_scalar is the type of weights and constants, offpiste_real that
   of one sample; in C++ the latter may be a GNU vector: define OFFPISTE_REAL, the type, offpiste_floor and
   offpiste_maximum first. With OFFPISTE_DOUBLE all of it is double precision, by the library's functions. */

#ifdef __CUDACC__ /* NVRTC defines it too */
#define OFFPISTE_FN static __host__ __device__ __forceinline__
#define OFFPISTE_UNROLL _Pragma("unroll")
#else
#include <math.h>
#if defined(__GNUC__)
#define OFFPISTE_FN static inline __attribute__((always_inline, unused))
#else
#define OFFPISTE_FN static inline
#endif
#define OFFPISTE_UNROLL
#endif

#ifdef __GNUC__
#define OFFPISTE_CONSTANT static const __attribute__((unused, aligned(16)))
#else
#define OFFPISTE_CONSTANT static const
#endif

/* Weights that were read before are read again: kept in registers, thousands of them would be spilled. An empty asm
   with a memory clobber is enough for NVVM, but ptxas does not see it. All threads of a warp must meet here. */
#ifdef __CUDA_ARCH__
#define OFFPISTE_FORGET __syncwarp();
#else
#define OFFPISTE_FORGET
#endif

#ifdef __cplusplus
#define OFFPISTE_TERM const auto /* of constants alone, or of a sample */
#else
#define OFFPISTE_TERM const offpiste_real
#endif

#ifdef OFFPISTE_DOUBLE
typedef double offpiste_scalar;
#else
typedef float offpiste_scalar;
#endif

#ifndef OFFPISTE_REAL
#define OFFPISTE_REAL
typedef offpiste_scalar offpiste_real;
OFFPISTE_FN offpiste_real offpiste_maximum(offpiste_real a, offpiste_real b) { return a > b ? a : b; }
/* Derivative of maximum by a. */
OFFPISTE_FN offpiste_real offpiste_above(offpiste_real a, offpiste_real b) {
    return a > b ? 1.0f : (a == b ? 0.5f : 0.0f);
}
#ifndef OFFPISTE_DOUBLE
OFFPISTE_FN offpiste_real offpiste_floor(offpiste_real x) { return floorf(x); }
#endif
#endif

#ifdef OFFPISTE_DOUBLE

OFFPISTE_FN double offpiste_sin(double x) { return sin(x); }
OFFPISTE_FN double offpiste_cos(double x) { return cos(x); }
OFFPISTE_FN double offpiste_tanh(double x) { return tanh(x); }
OFFPISTE_FN double offpiste_atan(double x) { return atan(x); }

#else

/* On GPUs 1 - 2 / (1 + e^2x), by their exponential and reciprocal. */
OFFPISTE_FN offpiste_real offpiste_tanh(offpiste_real x) {
#ifdef __CUDA_ARCH__
    float e = 2.8853900817779268f * x, r;
    asm("ex2.approx.ftz.f32 %0, %0;" : "+f"(e));
    e += 1.0f;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(e));
    return 1.0f - 2.0f * r;
#else
    const float limit = 7.905311f;
    offpiste_real s, p, q;
    x = x > limit ? limit : x;
    x = x < -limit ? -limit : x;
    s = x * x;
    p = s * -2.76076847742355e-16f + 2.00018790482477e-13f;
    p = p * s + -8.60467152213735e-11f;
    p = p * s + 5.12229709037114e-08f;
    p = p * s + 1.48572235717979e-05f;
    p = p * s + 6.37261928875436e-04f;
    p = p * s + 4.89352455891786e-03f;
    q = s * 1.19825839466702e-06f + 1.18534705686654e-04f;
    q = q * s + 2.26843463243900e-03f;
    q = q * s + 4.89352518554385e-03f;
    return x * p / q;
#endif
}

/* sin(x - n pi), pi in parts: the first three have few bits, so that their products with n below 2^13 are exact. */
OFFPISTE_FN offpiste_real offpiste_sin_less(offpiste_real x, offpiste_real n) {
    const float half = 1.5707964f;
    offpiste_real s, p;
    x = (((x - n * 3.140625f) - n * 9.670257568359375e-4f) - n * 6.277114152908325e-7f) - n * 1.215420125655342e-10f;
    x = x > half ? half : x;
    x = x < -half ? -half : x;
    s = x * x;
    p = s * -2.3889859e-8f + 2.7525562e-6f;
    p = p * s + -1.9840874e-4f;
    p = p * s + 8.3333310e-3f;
    p = p * s + -1.6666667e-1f;
    return x + x * s * p;
}

OFFPISTE_FN offpiste_real offpiste_sin(offpiste_real x) {
    const offpiste_real n = offpiste_floor(x * 0.31830987f + 0.5f);
    return (1.0f - 2.0f * (n - 2.0f * offpiste_floor(n * 0.5f))) * offpiste_sin_less(x, n);
}

OFFPISTE_FN offpiste_real offpiste_cos(offpiste_real x) {
    const offpiste_real n = offpiste_floor(x * 0.31830987f);
    return (2.0f * (n - 2.0f * offpiste_floor(n * 0.5f)) - 1.0f) * offpiste_sin_less(x, n + 0.5f);
}

/* Cephes' atanf: in three intervals of |x| around 0, 1 and infinity. */
OFFPISTE_FN offpiste_real offpiste_atan(offpiste_real x) {
    const offpiste_real a = x < 0.0f ? -x : x;
    const offpiste_real over = a > 2.4142136f ? -1.0f : (a > 0.41421357f ? a - 1.0f : a);
    const offpiste_real under = a > 2.4142136f ? a : (a > 0.41421357f ? a + 1.0f : 1.0f);
    const offpiste_real shift = a > 2.4142136f ? 1.5707964f : (a > 0.41421357f ? 0.7853982f : 0.0f);
    const offpiste_real z = over / under, s = z * z;
    offpiste_real p = s * 8.05374449538e-2f + -1.38776856032e-1f, y;
    p = p * s + 1.99777106478e-1f;
    p = p * s + -3.33329491539e-1f;
    y = (p * s * z + z) + shift;
    return x < 0.0f ? -y : y;
}

#endif
