/* One text for a GPU and, to check it, for the host. C++ only. A kernel gives each of n items to a thread: on the GPU
   one of a block of OFFPISTE_BLOCK; threads behind the last item repeat it, since all of a warp must live
   (OFFPISTE_FORGET), and write the same numbers again. Weights are read from shared memory: there are more of them than
   the cache of constants holds. */
#ifndef OFFPISTE_BLOCK
#define OFFPISTE_BLOCK 64
#endif

#ifdef __CUDACC__
#define OFFPISTE_KERNEL(name, ...) extern "C" __global__ void __launch_bounds__(OFFPISTE_BLOCK) name(__VA_ARGS__)
#define OFFPISTE_SHARED_PARAMS(params, given)                                                              \
    __shared__ float4 params##_shared[sizeof(offpiste_params) / 16];                                       \
    for (int k = threadIdx.x; k < (int)(sizeof(offpiste_params) / 16); k += OFFPISTE_BLOCK)                \
        params##_shared[k] = ((const float4*)given)[k];                                                    \
    __syncthreads();                                                                                       \
    const offpiste_params* params = (const offpiste_params*)params##_shared;
#define OFFPISTE_EACH(i, n) const int i = min((int)(blockIdx.x * OFFPISTE_BLOCK + threadIdx.x), n - 1);
#else
#define OFFPISTE_KERNEL(name, ...) extern "C" void name(__VA_ARGS__)
#define OFFPISTE_SHARED_PARAMS(params, given) const offpiste_params* params = given;
#define OFFPISTE_EACH(i, n) for (int i = 0; i < n; i++)
#endif
