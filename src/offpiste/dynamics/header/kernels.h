/* One text for a GPU and, to check it, for the host. C++ only. A kernel gives each of n items to a thread: on the GPU
   one of a block of OFFPISTE_BLOCK; threads behind the last item repeat it, since all of a warp must live
   (OFFPISTE_FORGET), and write the same numbers again. Weights are read from shared memory: there are more of them than
   the cache of constants holds. */
#ifndef OFFPISTE_BLOCK
#define OFFPISTE_BLOCK 64
#endif

#ifndef OFFPISTE_LANES
#define OFFPISTE_LANES 1 /* threads that share an item (lanes.h) */
#define OFFPISTE_LANE 0
#define offpiste_over_lanes(value) (value)
#endif

#if OFFPISTE_LANES > 1
#define OFFPISTE_ARRANGE(params, first, apart) offpiste_arrange((offpiste_params*)params, first, apart);
#else
#define OFFPISTE_ARRANGE(params, first, apart)
#endif

#ifdef __CUDACC__
#define OFFPISTE_KERNEL(name, ...) extern "C" __global__ void __launch_bounds__(OFFPISTE_BLOCK) name(__VA_ARGS__)
#define OFFPISTE_RESTRICT __restrict__
#define OFFPISTE_SHARED_PARAMS(params, given)                                                              \
    __shared__ float4 params##_shared[sizeof(offpiste_params) / 16];                                       \
    for (int k = threadIdx.x; k < (int)(sizeof(offpiste_params) / 16); k += OFFPISTE_BLOCK)                \
        params##_shared[k] = ((const float4*)given)[k];                                                    \
    __syncthreads();                                                                                       \
    OFFPISTE_ARRANGE(params##_shared, threadIdx.x, OFFPISTE_BLOCK)                                         \
    __syncthreads();                                                                                       \
    const offpiste_params* params = (const offpiste_params*)params##_shared;
#define OFFPISTE_EACH(i, n) const int i = min((int)(blockIdx.x * OFFPISTE_BLOCK + threadIdx.x), n - 1);
#define OFFPISTE_EACH_BY_LANES(i, n) \
    const int i = min((int)(blockIdx.x * OFFPISTE_BLOCK + threadIdx.x) / OFFPISTE_LANES, n - 1);
#else
#define OFFPISTE_KERNEL(name, ...) extern "C" void name(__VA_ARGS__)
#define OFFPISTE_RESTRICT
#define OFFPISTE_SHARED_PARAMS(params, given)  \
    offpiste_params params##_own = *given;     \
    OFFPISTE_ARRANGE(&params##_own, 0, 1)      \
    const offpiste_params* params = &params##_own;
#define OFFPISTE_EACH(i, n) for (int i = 0; i < n; i++)
#define OFFPISTE_EACH_BY_LANES(i, n) OFFPISTE_EACH(i, n)
#endif
