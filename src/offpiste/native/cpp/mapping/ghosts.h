/* Places the returns of a scan on a polar grid around the sensor, and finds its ground (mapping/ghosts.py). */
OFFPISTE_ENTRY(place_returns)(
    const double* points, int64_t count, const double* sensor, int64_t sectors, int64_t rings, double half,
    int32_t* cell, float* height, float* distance, float* low, float* away) {
    const float per_sector = float(sectors) / 4, last_sector = float(sectors - 1), last_ring = float(rings - 1);
    for (int64_t i = 0; i < count; i++) {
        const float x = float(points[3 * i] - sensor[0]), y = float(points[3 * i + 1] - sensor[1]);
        const float z = float(points[3 * i + 2] - sensor[2]), sum = fabsf(x) + fabsf(y), r = sqrtf(x * x + y * y);
        const bool good = (sum > 0.01f) & (r < 1e4f) & (fabsf(z) < 1e4f); /* false for NaN */
        const float share = y / sum, around = (x >= 0 ? 1 + share : 3 - share) * per_sector;
        const float out = float(rings) * (r / (r + float(half)));
        const int32_t sector = int32_t(good ? std::min(around, last_sector) : 0);
        const int32_t ring = int32_t(good ? std::min(out, last_ring) : 0);
        cell[i] = good ? sector * int32_t(rings) + ring : int32_t(sectors * rings);
        height[i] = z;
        distance[i] = r;
    }
    for (int64_t i = 0; i < count; i++) {
        if (!(height[i] < low[cell[i]])) continue;
        low[cell[i]] = height[i];
        away[cell[i]] = distance[i];
    }
}
