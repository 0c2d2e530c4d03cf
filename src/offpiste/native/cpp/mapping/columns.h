/* Ground, obstacles and features of voxel columns; layouts are those of mapping/ground.py. */
namespace {
constexpr int64_t BLOCK = 32;

/* Rows and columns wrap around, like those of the voxels. */
struct Surface {
    int32_t *level, *since;
    float *x, *y, *z, *obstacle, *feature_height, *features;
};

struct Limits {
    float size, reach;
};

/* Height of the hit `up` levels above the lowest voxel over the lowest hit of a column. */
inline float over_ground(const Voxel& voxel, int64_t up, const Voxel& hit, float size) {
    return (float(up) + voxel.z - hit.z) * size;
}

/* Height over the ground of the highest hit at most `reach` above it. */
inline float obstacle_above(
    const Voxels& voxels, int32_t occupied, const int32_t* slots, const Voxel& hit, const Limits& limits) {
    const float levels = limits.reach / limits.size;
    for (int64_t up = levels < float(LEVELS - 1) ? int64_t(levels) + 1 : LEVELS - 1; up > 0; up--) {
        if (!(occupied >> up & 1)) continue;
        const float above = over_ground(voxels.voxel(slots[up]), up, hit, limits.size);
        if (above <= limits.reach) return above;
    }
    return 0;
}

inline void see_column(
    const Voxels& voxels, const Surface& surface, int64_t cell, int64_t channels, const Limits& limits) {
    const Head& head = voxels.heads[cell];
    surface.feature_height[cell] = NAN;
    if (!head.occupied) {
        surface.z[cell] = NAN;
        return;
    }
    const int32_t* slots = voxels.column_slots(cell);
    const Voxel& hit = voxels.voxel(head.lowest);
    surface.level[cell] = head.base;
    surface.x[cell] = hit.x;
    surface.y[cell] = hit.y;
    surface.z[cell] = hit.z;
    surface.obstacle[cell] = head.occupied == 1 ? 0 : obstacle_above(voxels, head.occupied, slots, hit, limits);
    if (!head.featured) return;
    const int up = __builtin_ctz(uint32_t(head.featured));
    Voxel& featured = voxels.voxel(up ? slots[up] : head.lowest);
    surface.feature_height[cell] = up ? over_ground(featured, up, hit, limits.size) : 0;
    float* kept = surface.features + cell * (1 + channels);
    kept[0] = featured.feature_distance;
    memcpy(kept + 1, featured.features(), size_t(channels) * sizeof(float));
}

/* Updates the columns from `begin` to `end` of a row that changed since the last update, and others of their blocks. */
inline void see_blocks(
    const Voxels& voxels, const Surface& surface, int64_t row, int64_t begin, int64_t end, int64_t channels,
    const Limits& limits) {
    for (int64_t block = begin / BLOCK; block * BLOCK < end; block++) {
        int32_t& since = surface.since[row * ((voxels.cells + BLOCK - 1) / BLOCK) + block];
        const int32_t* changed = voxels.changed + row * voxels.cells;
        const int64_t from = block * BLOCK, to = std::min(from + BLOCK, voxels.cells);
        int32_t newest = since;
        for (int64_t i = from; i < to; i++) newest = std::max(newest, changed[i]);
        if (newest == since) continue;
        for (int64_t i = from; i < to; i++)
            if (changed[i] > since) see_column(voxels, surface, row * voxels.cells + i, channels, limits);
        since = newest;
    }
}
}

OFFPISTE_ENTRY(see_columns)(
    int64_t first, int64_t last, int64_t start_x, int64_t start_y, const int64_t* spans, double size, double reach,
    Head* heads, int32_t* changed, int32_t* slots, int32_t* level, float* hits, float* features, int32_t* since,
    int64_t cells, int64_t channels, int64_t width, float* seen) {
    const Voxels voxels{heads, changed, slots, seen, nullptr, nullptr, cells, width, 0};
    const int64_t area = cells * cells;
    const Surface surface{level, since, hits, hits + area, hits + 2 * area, hits + 3 * area, hits + 4 * area, features};
    const Limits limits{float(size), float(reach)};
    for (int64_t j = first; j < last; j++) {
        const int64_t row = (start_y + j) % cells, count = spans[2 * j + 1] - spans[2 * j];
        const int64_t begin = (start_x + spans[2 * j]) % cells, wrapped_end = begin + count - cells;
        if (count <= 0) continue;
        see_blocks(voxels, surface, row, begin, std::min(begin + count, cells), channels, limits);
        if (wrapped_end > 0) see_blocks(voxels, surface, row, 0, wrapped_end, channels, limits);
    }
}
