/* Surface normals and roughness from least-squares planes (mapping/normals.py). */
namespace {
constexpr float MIN_SPREAD = 0.2f;
constexpr int64_t STRIP = 64; /* columns that are processed together, so that their sums stay in the cache */

/* Sums over the points of a window, x and y relative to its centre. */
struct PlaneSums {
    offpiste_real count, x, y, z, xx, xy, yy, xz, yz;
};

struct Plane {
    offpiste_real rise_x, rise_y, centre, residual;
};

struct ResidualSums {
    offpiste_real count, squares;
};

/* Sums of the rows of a window, the oldest at `start`, in a ring of 2 radius + 1. */
template <typename Sums>
struct RowSums {
    const Sums* ring;
    int64_t apart, start, radius;
    const Sums& operator[](int64_t k) const { return ring[(start + k + radius) % (2 * radius + 1) * apart]; }
};

/* Sums along the row over the cells up to `radius` from some cells; neighbours are `step` floats apart. Not inlined,
   so that planes of a whole map and of single cells are rounded alike. */
__attribute__((noinline)) void sum_row(
    const float* x, const float* y, const float* z, int64_t step, int64_t radius, PlaneSums* sums) {
    PlaneSums s = {};
    const offpiste_real zero = {}, one = all_lanes(1.0f);
    for (int64_t k = -radius; k <= radius; k++) {
        const offpiste_real height = load(z + k * step);
        const offpiste_whole there = height == height;
        const offpiste_real u = there ? load(x + k * step) + float(k) : zero, v = there ? load(y + k * step) : zero;
        const offpiste_real w = there ? height : zero;
        s.count += there ? one : zero;
        s.x += u;
        s.y += v;
        s.z += w;
        s.xx += u * u;
        s.xy += u * v;
        s.yy += v * v;
        s.xz += u * w;
        s.yz += v * w;
    }
    *sums = s;
}

/* Fits planes to the rows of windows around hits x, y, z; NaN where they define no plane or there is no hit. */
__attribute__((noinline)) void fit_plane(
    const RowSums<PlaneSums>& rows, const float* x, const float* y, const float* z, float size, Plane* plane) {
    PlaneSums s = {};
    for (int64_t k = -rows.radius; k <= rows.radius; k++) {
        const PlaneSums& row = rows[k];
        const float up = float(k);
        s.count += row.count;
        s.x += row.x;
        s.y += row.y + up * row.count;
        s.z += row.z;
        s.xx += row.xx;
        s.xy += row.xy + up * row.x;
        s.yy += row.yy + up * (row.y + row.y + up * row.count);
        s.xz += row.xz;
        s.yz += row.yz + up * row.z;
    }
    const offpiste_real share = 1.0f / s.count, mean_x = s.x * share, mean_y = s.y * share, mean_z = s.z * share;
    const offpiste_real xx = s.xx * share - mean_x * mean_x, xy = s.xy * share - mean_x * mean_y;
    const offpiste_real yy = s.yy * share - mean_y * mean_y, xz = s.xz * share - mean_x * mean_z;
    const offpiste_real yz = s.yz * share - mean_y * mean_z;
    const offpiste_real trace = xx + yy, determinant = xx * yy - xy * xy, height = load(z);
    /* Both eigenvalues are at least MIN_SPREAD. */
    const offpiste_whole good = (trace >= 2 * MIN_SPREAD) & (s.count >= 3.0f) & (height == height) &
                                (determinant - MIN_SPREAD * trace + MIN_SPREAD * MIN_SPREAD >= 0.0f);
    const offpiste_real scale = 1.0f / (size * determinant), nothing = all_lanes(NAN), hit_x = load(x), hit_y = load(y);
    plane->rise_x = good ? (xz * yy - yz * xy) * scale : nothing;
    plane->rise_y = good ? (yz * xx - xz * xy) * scale : nothing;
    offpiste_real down = size * (plane->rise_x * hit_x + plane->rise_y * hit_y);
    down = down == down ? down : offpiste_real{};
    down = down > size ? all_lanes(size) : down;
    plane->centre = height - (down < -size ? all_lanes(-size) : down);
    const offpiste_real off = height - mean_z - size * plane->rise_x * (hit_x - mean_x) -
                              size * plane->rise_y * (hit_y - mean_y);
    plane->residual = off * off;
}

/* Calls sum(j, i, sums) for cells of the rows first - radius ... last + radius - 1, and use(j, i, rows) for those of
   the rows first ... last - 1 when the sums of their windows are complete. */
template <typename Sums, typename Sum, typename Use>
void slide(int64_t first, int64_t last, int64_t cells, int64_t radius, Sum sum, Use use) {
    const int64_t window = 2 * radius + 1, apart = STRIP / LANES;
    const Vectors memory(size_t(window * apart) * (sizeof(Sums) / sizeof(offpiste_real)));
    Sums* const ring = reinterpret_cast<Sums*>(memory.at);
    for (int64_t begin = 0; begin < cells; begin += STRIP) {
        const int64_t count = (std::min(STRIP, cells - begin) + LANES - 1) / LANES;
        for (int64_t ahead = first - radius; ahead < last + radius; ahead++) {
            const int64_t newest = (ahead - first + radius) % window, j = ahead - radius;
            for (int64_t k = 0; k < count; k++) sum(ahead, begin + k * LANES, ring + newest * apart + k);
            if (j < first) continue;
            for (int64_t k = 0; k < count; k++)
                use(j, begin + k * LANES, RowSums<Sums>{ring + k, apart, newest + 1, radius});
        }
    }
}
}

/* Fits planes around the cells of rows. */
OFFPISTE_ENTRY(fit_planes)(
    int64_t first, int64_t last, int64_t radius, double size, float* grids, int64_t cells, int64_t border) {
    const Grids g{grids, cells, border};
    const auto sum = [&](int64_t j, int64_t i, PlaneSums* sums) {
        sum_row(g.row(GRID_X, j) + i, g.row(GRID_Y, j) + i, g.row(GRID_HEIGHT, j) + i, 1, radius, sums);
    };
    const auto use = [&](int64_t j, int64_t i, const RowSums<PlaneSums>& rows) {
        Plane plane;
        const float *x = g.row(GRID_X, j) + i, *y = g.row(GRID_Y, j) + i, *z = g.row(GRID_HEIGHT, j) + i;
        fit_plane(rows, x, y, z, float(size), &plane);
        store(g.row(RISE_X, j) + i, plane.rise_x);
        store(g.row(RISE_Y, j) + i, plane.rise_y);
        store(g.row(CENTRE, j) + i, plane.centre);
        store(g.row(RESIDUAL, j) + i, plane.residual);
    };
    slide<PlaneSums>(first, last, cells, radius, sum, use);
}

/* Writes the roughness: root mean square of the residuals in the window of each cell with a plane. */
OFFPISTE_ENTRY(smooth_residuals)(
    int64_t first, int64_t last, int64_t radius, float* grids, int64_t cells, int64_t border) {
    const Grids g{grids, cells, border};
    const auto sum = [&](int64_t j, int64_t i, ResidualSums* sums) {
        ResidualSums s = {};
        for (int64_t k = -radius; k <= radius; k++) {
            const offpiste_real there = load(g.row(RESIDUAL, j) + i + k);
            s.count += there == there ? all_lanes(1.0f) : offpiste_real{};
            s.squares += there == there ? there : offpiste_real{};
        }
        *sums = s;
    };
    const auto use = [&](int64_t j, int64_t i, const RowSums<ResidualSums>& rows) {
        ResidualSums s = {};
        for (int64_t k = -radius; k <= radius; k++) {
            s.count += rows[k].count;
            s.squares += rows[k].squares;
        }
        const offpiste_real rise = load(g.row(RISE_X, j) + i);
        store(g.row(ROUGHNESS, j) + i, rise == rise ? square_root(s.squares / s.count) : all_lanes(NAN));
    };
    slide<ResidualSums>(first, last, cells, radius, sum, use);
}
