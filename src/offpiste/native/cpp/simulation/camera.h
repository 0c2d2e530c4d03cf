/* Development of pictures from linear light (sensors/camera.py). */

/* Develops rows first ... last - 1 of interleaved RGB [height][3 * width]: vignetting, shot and read noise (EMVA 1288),
   tone curve. Noise depends on seed and pixel alone, not on the split over threads.
   gain: [3 * width]; curve: tone of 4096 levels of brightness, 0 ... 2. */
OFFPISTE_ENTRY(develop)(
    int64_t first, int64_t last, int64_t height, int64_t width, const float* linear, const float* gain,
    double vignetting, double full_well, double read_noise, const uint8_t* curve, int64_t seed, uint8_t* image) {
    constexpr int64_t part = 256;
    int32_t level[part];
    const int64_t values = 3 * width;
    const float middle_u = 0.5f * (float)width, middle_v = 0.5f * (float)height;
    const float darker = (float)vignetting / (middle_u * middle_u + middle_v * middle_v);
    const float shot = 1 / (float)full_well, read = (float)(read_noise * read_noise);
    for (int64_t v = first; v < last; v++) {
        const float dv = (float)v - middle_v;
        for (int64_t begin = 0; begin < values; begin += part) {
            const int count = (int)std::min(part, values - begin);
            const float *light = linear + v * values + begin, *gains = gain + begin;
            for (int n = 0; n < count; n++) {
                const int64_t k = begin + n;
                /* A sum of four uniform numbers is nearly normal, with variance 1/3. */
                const float even = shading::hashed(k, v, seed) + shading::hashed(k, v, seed + 1);
                const float noise = even + (shading::hashed(v, k, seed) + shading::hashed(v, k, seed + 1)) - 2;
                const float du = (float)((int32_t)k / 3) - middle_u;
                const float value = std::max(light[n] * gains[n] * (1 - darker * (du * du + dv * dv)), 0.0f);
                const float noisy = value + noise * 1.732f * std::sqrt(value * shot + read);
                level[n] = (int32_t)shading::limited(noisy * 2047.5f, 0.0f, 4095.0f);
            }
            for (int n = 0; n < count; n++) image[v * values + begin + n] = curve[level[n]];
        }
    }
}
