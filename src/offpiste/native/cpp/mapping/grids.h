/* Grids of the ground around the vehicle, with a border of unknown cells; the layout is that of mapping/ground.py. */
namespace {
constexpr int64_t LANES = OFFPISTE_WIDTH, GRIDS_ROUNDED = 16;

enum {
    GRID_X, GRID_Y, GRID_HEIGHT, GRID_OBSTACLE, GRID_FEATURE, GRID_BESIDE, RISE_X, RISE_Y, CENTRE, RESIDUAL, ROUGHNESS
};

struct Grids {
    float* first;
    int64_t cells, border;

    int64_t stride() const { return (cells + GRIDS_ROUNDED - 1) / GRIDS_ROUNDED * GRIDS_ROUNDED + 2 * border; }
    float* row(int64_t grid, int64_t j) const {
        return first + ((grid * (cells + 2 * border) + border + j) * stride() + border);
    }
};
}

/* Copies spans of columns in the order of the grids, and finds the lowest ground within `radius` cells along rows. */
OFFPISTE_ENTRY(read_columns)(
    int64_t first, int64_t last, int64_t start_x, int64_t start_y, const int64_t* spans, int64_t reference, double size,
    int64_t radius, const int32_t* level, const float* surface, float* grids, int64_t cells, int64_t border) {
    const Grids to{grids, cells, border};
    const int64_t area = cells * cells;
    for (int64_t j = first; j < last; j++) {
        const int64_t row = (start_y + j) % cells * cells, begin = spans[2 * j], end = spans[2 * j + 1];
        const int64_t middle = std::min(std::max(begin, cells - start_x), end);
        float* height = to.row(GRID_HEIGHT, j);
        for (int part = 0; part < 2; part++) {
            const int64_t from = part ? middle : begin, until = part ? end : middle;
            const int64_t shift = row + start_x - (part ? cells : 0);
            const size_t bytes = size_t(until > from ? until - from : 0) * sizeof(float);
            for (int64_t i = from; i < until; i++)
                height[i] =
                    (float(int32_t(level[shift + i] - reference)) + surface[2 * area + shift + i]) * float(size);
            if (!bytes) continue;
            memcpy(to.row(GRID_X, j) + from, surface + shift + from, bytes);
            memcpy(to.row(GRID_Y, j) + from, surface + area + shift + from, bytes);
            memcpy(to.row(GRID_OBSTACLE, j) + from, surface + 3 * area + shift + from, bytes);
            memcpy(to.row(GRID_FEATURE, j) + from, surface + 4 * area + shift + from, bytes);
        }
        for (int64_t i = begin / LANES * LANES; i < end; i += LANES) {
            offpiste_real lowest = all_lanes(INFINITY);
            for (int64_t k = -radius; k <= radius; k++) {
                const offpiste_real there = load(height + i + k);
                lowest = there < lowest ? there : lowest; /* NaN is not less */
            }
            store(to.row(GRID_BESIDE, j) + i, lowest);
        }
    }
}

/* Removes the ground of columns whose lowest voxel is a branch, and features too far above the ground. */
OFFPISTE_ENTRY(drop_overhangs)(
    int64_t first, int64_t last, const int64_t* spans, int64_t radius, double reach, double limit, float* grids,
    int64_t cells, int64_t border) {
    const Grids of{grids, cells, border};
    const offpiste_real nothing = all_lanes(NAN);
    for (int64_t j = first; j < last; j++) {
        float *heights = of.row(GRID_HEIGHT, j), *features = of.row(GRID_FEATURE, j);
        for (int64_t i = spans[2 * j] / LANES * LANES; i < spans[2 * j + 1]; i += LANES) {
            offpiste_real lowest = all_lanes(INFINITY);
            for (int64_t k = -radius; k <= radius; k++) {
                const offpiste_real there = load(of.row(GRID_BESIDE, j + k) + i);
                lowest = there < lowest ? there : lowest;
            }
            const offpiste_real height = load(heights + i), feature = load(features + i);
            const offpiste_whole is_ground = height <= lowest + float(reach);
            store(features + i, (is_ground & (feature <= float(limit))) ? height + feature : nothing);
            store(heights + i, is_ground ? height : nothing);
        }
    }
}
