/* Layers of a map, with gaps filled from the nearest cell (mapping/infill.py). */
namespace {
/* Ground that fills some cells, NaN without any nearby. */
struct Found {
    offpiste_real height, rise_x, rise_y, centre, obstacle, roughness;
    offpiste_whole own;
    const float* features[LANES]; /* sensor distance and features, null without any */
};

/* Arrays of the layers; those that are null are not written. */
struct Layers {
    double* elevation;
    float *normal, *slope, *roughness, *obstacle, *features, *distance;
    bool *known, *observed, *valid;
    int64_t channels;
};

/* Writes the layers of the cells from `at`. Not inlined, so that whole maps and single cells are rounded alike. */
__attribute__((noinline)) void write_found(
    const Found& found, double floor, const Layers& layers, int64_t at, int64_t count) {
    const offpiste_real squared = found.rise_x * found.rise_x + found.rise_y * found.rise_y;
    const offpiste_real up = 1.0f / square_root(1.0f + squared), x = -found.rise_x * up, y = -found.rise_y * up;
    const offpiste_whole known = found.height == found.height;
    const offpiste_real centre = known ? found.centre : all_lanes(NAN);
    const offpiste_real obstacle = known ? found.obstacle : all_lanes(NAN), slope = square_root(squared);
    for (int64_t k = 0; k < count; k++) {
        float* normal = layers.normal + 3 * (at + k);
        normal[0] = x[k];
        normal[1] = y[k];
        normal[2] = up[k];
    }
    for (int64_t k = 0; k < count; k++) layers.elevation[at + k] = floor + double(centre[k]);
    for (int64_t k = 0; k < count; k++) layers.known[at + k] = known[k];
    if (layers.slope) {
        for (int64_t k = 0; k < count; k++) layers.slope[at + k] = slope[k];
        for (int64_t k = 0; k < count; k++) layers.roughness[at + k] = found.roughness[k];
        for (int64_t k = 0; k < count; k++) layers.obstacle[at + k] = obstacle[k];
        for (int64_t k = 0; k < count; k++) layers.observed[at + k] = found.own[k];
    }
    for (int64_t k = at; k < at + count; k++) {
        const float* seen = found.features[k - at];
        float* features = layers.features + k * layers.channels;
        if (seen) {
            layers.distance[k] = seen[0];
            memcpy(features, seen + 1, size_t(layers.channels) * sizeof(float));
        } else if (layers.valid[k]) { /* otherwise they are NaN already */
            layers.distance[k] = NAN;
            for (int64_t c = 0; c < layers.channels; c++) features[c] = NAN;
        }
        layers.valid[k] = seen != nullptr;
    }
}

/* Sensor distance and features of a cell, which wrap around like the voxels. */
struct SeenFeatures {
    const float* first;
    int64_t cells, channels, start_x, start_y;

    const float* at(int64_t j, int64_t i) const {
        const int64_t row = start_y + j, across = start_x + i;
        const int64_t cell = (row < cells ? row : row - cells) * cells + (across < cells ? across : across - cells);
        return first + cell * (1 + channels);
    }
};
}

inline Found ground_at(const Grids& grids, int64_t j, int64_t i) {
    Found found = {};
    found.height = load(grids.row(GRID_HEIGHT, j) + i);
    found.rise_x = load(grids.row(RISE_X, j) + i);
    found.rise_y = load(grids.row(RISE_Y, j) + i);
    found.centre = load(grids.row(CENTRE, j) + i);
    found.obstacle = load(grids.row(GRID_OBSTACLE, j) + i);
    found.roughness = load(grids.row(ROUGHNESS, j) + i);
    return found;
}

/* Replaces the ground of cells without their own by that of neighbours. */
inline void fill_ground(
    const Grids& grids, int64_t j, int64_t i, offpiste_whole which, const int64_t* offsets, Found& found) {
    for (int64_t k = 0; k < LANES; k++) {
        if (which[k] <= 0) continue;
        const int64_t down = j + offsets[2 * which[k]], across = i + k + offsets[2 * which[k] + 1];
        found.rise_x[k] = grids.row(RISE_X, down)[across];
        found.rise_y[k] = grids.row(RISE_Y, down)[across];
        found.centre[k] = grids.row(CENTRE, down)[across];
        found.obstacle[k] = grids.row(GRID_OBSTACLE, down)[across];
        found.roughness[k] = grids.row(ROUGHNESS, down)[across];
    }
}

/* Writes the layers of the rows first ... last - 1. */
OFFPISTE_ENTRY(write_layers)(
    int64_t first, int64_t last, double floor, double limit, const int64_t* offsets, int64_t count, float* grids,
    int64_t cells, int64_t border, const float* seen, int64_t channels, int64_t start_x, int64_t start_y,
    double* elevation, float* normal, float* slope, float* roughness, float* obstacle, float* features, float* distance,
    bool* known, bool* observed, bool* valid) {
    const Grids g{grids, cells, border};
    const SeenFeatures all{seen, cells, channels, start_x, start_y};
    const Layers layers{
        elevation, normal, slope, roughness, obstacle, features, distance, known, observed, valid, channels};
    const int64_t stride = g.stride();
    const float most = float(limit);
    for (int64_t j = first; j < last; j++) {
        for (int64_t i = 0; i < cells; i += LANES) {
            const float *heights = g.row(GRID_HEIGHT, j) + i, *feature_heights = g.row(GRID_FEATURE, j) + i;
            offpiste_whole which = offpiste_whole{} - 1, feature = which;
            offpiste_real height = all_lanes(NAN);
            for (int64_t k = count - 1; k >= 0; k--) {
                const offpiste_real there = load(heights + offsets[2 * k] * stride + offsets[2 * k + 1]);
                which = there == there ? offpiste_whole{} + int(k) : which;
                height = there == there ? there : height;
            }
            for (int64_t k = count - 1; k >= 0; k--) {
                const float* there = feature_heights + offsets[2 * k] * stride + offsets[2 * k + 1];
                const offpiste_real off = load(there) - height;
                feature = ((off <= most) & (off >= -most)) ? offpiste_whole{} + int(k) : feature;
            }
            Found found = ground_at(g, j, i);
            if (any_lane(which > 0)) fill_ground(g, j, i, which, offsets, found);
            found.height = height;
            found.own = which == 0;
            int32_t numbers[LANES];
            memcpy(numbers, &feature, sizeof(feature));
            const int64_t inside = std::min(LANES, cells - i);
            for (int64_t k = 0; k < inside; k++) {
                const int64_t* offset = offsets + 2 * std::max(numbers[k], 0);
                found.features[k] = numbers[k] < 0 ? nullptr : all.at(j + offset[0], i + k + offset[1]);
            }
            write_found(found, floor, layers, j * cells + i, inside);
        }
    }
}

/* Writes the values of `fit_planes` and `write_layers` for some cells only. */
OFFPISTE_ENTRY(read_cells)(
    const int64_t* rows, const int64_t* columns, int64_t wanted, int64_t radius, double size, double floor,
    double limit, const int64_t* offsets, int64_t count, float* grids, int64_t cells, int64_t border, const float* seen,
    int64_t channels, int64_t start_x, int64_t start_y, double* elevation, float* normal, float* features,
    float* distance, bool* known, bool* valid) {
    const Grids g{grids, cells, border};
    const SeenFeatures all{seen, cells, channels, start_x, start_y};
    const Layers layers{
        elevation, normal, nullptr, nullptr, nullptr, features, distance, known, nullptr, valid, channels};
    const int64_t window = 2 * radius + 1;
    const float most = float(limit);
    const Vectors memory(size_t(window) * (3 + sizeof(PlaneSums) / sizeof(offpiste_real)));
    PlaneSums* const sums = reinterpret_cast<PlaneSums*>(memory.at);
    float* const hits[3] = {(float*)(sums + window), (float*)(sums + window) + window * LANES,
                            (float*)(sums + window) + 2 * window * LANES}; /* x, y, z [window][LANES] */
    for (int64_t begin = 0; begin < wanted; begin += LANES) {
        Found found = {};
        int64_t from_j[LANES], from_i[LANES];
        for (int64_t lane = 0; lane < LANES; lane++) {
            const int64_t q = std::min(begin + lane, wanted - 1), j = rows[q], i = columns[q];
            int64_t k = 0, feature = 0;
            const auto height_at = [&](int64_t grid, int64_t number) {
                return g.row(grid, j + offsets[2 * number])[i + offsets[2 * number + 1]];
            };
            while (k < count && height_at(GRID_HEIGHT, k) != height_at(GRID_HEIGHT, k)) k++;
            from_j[lane] = j + (k < count ? offsets[2 * k] : 0);
            from_i[lane] = i + (k < count ? offsets[2 * k + 1] : 0);
            const float ground = g.row(GRID_HEIGHT, from_j[lane])[from_i[lane]];
            found.height[lane] = ground;
            for (; feature < count; feature++) {
                const float off = height_at(GRID_FEATURE, feature) - ground;
                if (off <= most && off >= -most) break;
            }
            found.features[lane] =
                feature < count ? all.at(j + offsets[2 * feature], i + offsets[2 * feature + 1]) : nullptr;
        }
        for (int64_t down = -radius; down <= radius; down++) {
            for (int grid = 0; grid < 3; grid++)
                for (int64_t lane = 0; lane < LANES; lane++) {
                    const float* from = g.row(grid, from_j[lane] + down) + from_i[lane] - radius;
                    for (int64_t right = 0; right < window; right++) hits[grid][right * LANES + lane] = from[right];
                }
            const int64_t middle = radius * LANES;
            sum_row(hits[0] + middle, hits[1] + middle, hits[2] + middle, LANES, radius, sums + down + radius);
        }
        float own[3][LANES];
        for (int grid = 0; grid < 3; grid++)
            for (int64_t lane = 0; lane < LANES; lane++) own[grid][lane] = g.row(grid, from_j[lane])[from_i[lane]];
        Plane plane;
        fit_plane({sums, 1, 0, radius}, own[0], own[1], own[2], float(size), &plane);
        found.rise_x = plane.rise_x;
        found.rise_y = plane.rise_y;
        found.centre = plane.centre;
        write_found(found, floor, layers, begin, std::min(LANES, wanted - begin));
    }
}
