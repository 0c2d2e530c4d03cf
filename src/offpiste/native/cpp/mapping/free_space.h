/* Range image of a scan, and removal of voxels that its rays pass through (mapping/free_space.py). */
namespace {
constexpr float STEEPEST = -1, SLOPE = 0.025f;
constexpr int64_t IMAGE_ROWS = 64, IMAGE_COLUMNS = 256;

/* Index of the pixel of a point relative to the sensor, -1 outside the image, and its horizontal distance. */
inline int32_t pixel_of(float x, float y, float z, float& r) {
    const float away = fabsf(x) + fabsf(y);
    r = sqrtf(x * x + y * y);
    const float row = (z / r - STEEPEST) * (1 / SLOPE), share = y / away;
    const bool inside = (away > 0.01f) & (away < 1e4f) & (row >= 0) & (row < float(IMAGE_ROWS)); /* false for NaN */
    const float around = x >= 0 ? 1 + share : 3 - share;
    const int32_t column = std::min(int32_t((inside ? around : 0) * (IMAGE_COLUMNS / 4)), int32_t(IMAGE_COLUMNS - 1));
    return inside ? int32_t(inside ? row : 0) * int32_t(IMAGE_COLUMNS) + column : -1;
}

/* The nearest cell coordinate from `low` to low + cells. */
inline int64_t within(double coordinate, int64_t low, int64_t cells) {
    return int64_t(std::min(std::max(double(low), coordinate), double(low + cells)));
}
}

/* Puts the nearest return of each pixel, and counts its returns. */
OFFPISTE_ENTRY(put_returns)(
    const double* points, int64_t count, const double* sensor, const bool* left_out,
    float* nearest, int32_t* many) {
    int32_t pixels[256];
    float distances[256];
    for (int64_t begin = 0; begin < count; begin += 256) {
        const int64_t block = std::min(count - begin, int64_t(256));
        for (int64_t i = 0; i < block; i++) {
            const double* point = points + 3 * (begin + i);
            pixels[i] = pixel_of(
                float(point[0] - sensor[0]), float(point[1] - sensor[1]), float(point[2] - sensor[2]), distances[i]);
        }
        for (int64_t i = 0; i < block; i++) {
            if (pixels[i] < 0 || left_out[begin + i]) continue;
            many[pixels[i]]++;
            nearest[pixels[i]] = std::min(nearest[pixels[i]], distances[i]);
        }
    }
}

/* Removes voxels that rays passed through `times` times since the last hit, in every `stride`th row; their number. */
OFFPISTE_ENTRY_OF(int64_t, clear_passed)(
    int64_t first, int64_t stride, const int64_t* low, double reach, const double* sensor,
    double size, const float* near, const int32_t* many, double beyond, int64_t returns, int64_t times, int64_t number,
    Head* heads, int32_t* changed, int32_t* slots, float* seen, int32_t* freed, PartCounts* counts, int64_t cells,
    int64_t width, int64_t part_slots) {
    const Voxels voxels{heads, changed, slots, seen, freed, counts, cells, width, part_slots};
    const double x = floor(sensor[0] / size), y = floor(sensor[1] / size);
    const int64_t first_i = within(x - reach, low[0], cells), last_i = within(x + reach + 1, low[0], cells);
    const int64_t first_j = within(y - reach, low[1], cells), last_j = within(y + reach + 1, low[1], cells);
    int64_t gone = 0;
    for (int64_t j = first_j; j < last_j; j++) {
        if (wrapped(j, stride) != first) continue;
        const int64_t row = wrapped(j, cells);
        for (int64_t i = first_i; i < last_i; i++) {
            const int64_t cell = row * cells + wrapped(i, cells);
            Head& head = heads[cell];
            for (int32_t above = head.occupied & ~1; above; above &= above - 1) {
                const int level = __builtin_ctz(uint32_t(above));
                const int32_t slot = voxels.column_slots(cell)[level];
                Voxel& voxel = voxels.voxel(slot);
                float r;
                const int32_t pixel = pixel_of(
                    float((double(i) + 0.5 + voxel.x) * size - sensor[0]),
                    float((double(j) + 0.5 + voxel.y) * size - sensor[1]),
                    float((double(head.base) + level + voxel.z) * size - sensor[2]), r);
                if (pixel < 0 || many[pixel] < returns || !(near[pixel] > r + float(beyond))) continue;
                if (++voxel.passed < float(times)) continue;
                release_slot(voxels, part_of_row(row), slot);
                head.occupied &= ~(int32_t(1) << level);
                head.featured &= ~(int32_t(1) << level);
                changed[cell] = int32_t(number);
                gone++;
            }
        }
    }
    return gone;
}
