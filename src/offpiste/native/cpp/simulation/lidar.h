/* Rays of a spinning LiDAR, and the points that return (sensors/lidar.py). */

/* Turns rays [rings][columns][3] by the rotation of each column [columns][3][3]. */
OFFPISTE_ENTRY(turn_rays)(
    int64_t rings, int64_t columns, const double* rotation, const double* ray_body, float* ray_world) {
    for (int64_t r = 0; r < rings; r++)
        for (int64_t c = 0; c < columns; c++) {
            const double *turn = rotation + 9 * c, *ray = ray_body + 3 * (r * columns + c);
            float* to = ray_world + 3 * (r * columns + c);
            for (int i = 0; i < 3; i++)
                to[i] = (float)(turn[3 * i] * ray[0] + turn[3 * i + 1] * ray[1] + turn[3 * i + 2] * ray[2]);
        }
}

/* Sorts hits of the rings first ... last - 1 by column, into [columns][rings], and computes reflectivity times the cosine
   of incidence. */
OFFPISTE_ENTRY(reflect)(
    int64_t first, int64_t last, int64_t rings, int64_t columns, const float* reflectivity, const float* ray,
    const float* distances, const int8_t* surfaces, const float* normal, float* distance, float* echo, int8_t* surface) {
    for (int64_t r = first; r < last; r++)
        for (int64_t c = 0; c < columns; c++) {
            const int64_t n = (r - first) * columns + c, to = c * rings + r;
            const float *a = normal + 3 * n, *b = ray + 3 * n;
            distance[to] = distances[n];
            surface[to] = surfaces[n];
            echo[to] = reflectivity[surfaces[n]] * std::abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
        }
}

/* Measures the points of rays [count][3] that return, and writes their indices; returns their number.
   At least the share `dropout` of rays is lost. The echo fades with the square of the range; at the farthest range, the
   share `lost` of the remaining rays is lost where the echo is 0.1.
   random: uniform in [0, 1); noise: of the range [m]. */
OFFPISTE_ENTRY_OF(int64_t, measure_points)(
    int64_t count, double nearest, double farthest, double dropout, double lost, const double* ray,
    const float* distance, const float* echo, const double* random, const double* noise, int32_t* returned,
    float* points) {
    const float doublings = (float)std::log2(std::max(lost, 1e-30)); /* powers take longer */
    int64_t found = 0;
    for (int64_t n = 0; n < count; n++) {
        if (!(nearest < distance[n] && distance[n] < farthest) || random[n] <= dropout) continue;
        const float ratio = (float)farthest / distance[n];
        const float exponent = doublings * std::max(echo[n] * 10 * (ratio * ratio), 0.0f);
        const float share = exponent > -60 ? std::exp2(exponent) : 0.0f;
        if (random[n] <= dropout + (1 - dropout) * share) continue;
        for (int axis = 0; axis < 3; axis++)
            points[3 * found + axis] = (float)(ray[3 * n + axis] * (distance[n] + noise[n]));
        returned[found++] = (int32_t)n;
    }
    return found;
}
