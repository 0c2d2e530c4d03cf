/* Four lanes, neighbours in a warp, step one sample: each has a unit of every LSTM and a quarter of every hidden layer
   (network_lanes.h), and all do the rest alike. So a step is shorter, and there are more warps to take turns. On the
   host, whose tests are threads that wait for each other, define OFFPISTE_LANE and offpiste_from_lane first. */
#define OFFPISTE_LANES 4

#ifdef __CUDACC__
#define OFFPISTE_LANE (threadIdx.x % OFFPISTE_LANES)
static __device__ __forceinline__ float offpiste_from_lane(float value, int lane) {
    return __shfl_sync(0xffffffff, value, lane, OFFPISTE_LANES);
}
static __device__ __forceinline__ float offpiste_over_lanes(float value) {
    value += __shfl_xor_sync(0xffffffff, value, 1);
    return value + __shfl_xor_sync(0xffffffff, value, 2);
}
static __device__ __forceinline__ float offpiste_least_of_lanes(float value) {
    value = fminf(value, __shfl_xor_sync(0xffffffff, value, 1));
    return fminf(value, __shfl_xor_sync(0xffffffff, value, 2));
}
#else
static inline float offpiste_over_lanes(float value) {
    const float a = offpiste_from_lane(value, 0), b = offpiste_from_lane(value, 1);
    const float c = offpiste_from_lane(value, 2), d = offpiste_from_lane(value, 3);
    return a + b + c + d;
}
static inline float offpiste_least_of_lanes(float value) {
    const float a = offpiste_from_lane(value, 0), b = offpiste_from_lane(value, 1);
    const float c = offpiste_from_lane(value, 2), d = offpiste_from_lane(value, 3);
    return fminf(fminf(a, b), fminf(c, d));
}
#endif

/* The larger and the smaller number; of NaN and a number the number. */
OFFPISTE_FN float offpiste_least(float a, float b) { return fminf(a, b); }
OFFPISTE_FN float offpiste_most(float a, float b) { return fmaxf(a, b); }

/* Adds four neighbours, at a multiple of 16 bytes, times a factor. */
OFFPISTE_FN void offpiste_add_four(float* sums, const float* four, float factor) {
#ifdef __CUDACC__
    const float4 w = *(const float4*)four;
    sums[0] += w.x * factor;
    sums[1] += w.y * factor;
    sums[2] += w.z * factor;
    sums[3] += w.w * factor;
#else
    for (int k = 0; k < 4; k++) sums[k] += four[k] * factor;
#endif
}

/* Rows of a matrix on gates, [4 gates][4 units], as [4 units][4 gates]: a lane's own are neighbours. */
OFFPISTE_FN void offpiste_by_unit(float* rows, int count, int first, int apart) {
    for (int r = first; r < count; r += apart)
        for (int gate = 0; gate < 4; gate++)
            for (int unit = 0; unit < gate; unit++) {
                const float kept = rows[16 * r + 4 * gate + unit];
                rows[16 * r + 4 * gate + unit] = rows[16 * r + 4 * unit + gate];
                rows[16 * r + 4 * unit + gate] = kept;
            }
}
