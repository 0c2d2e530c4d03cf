/* Sampled controls moved into bounds and rates (planning/controls.py). NaN stays, and spreads to all later steps. */

namespace {
struct Bounds {
    const float *previous, *low, *high, *change; /* previous: NaN leaves the first step free */
    int count, steps, columns, free;
};

OFFPISTE_INLINE offpiste_real clamped(offpiste_real x, offpiste_real low, offpiste_real high) {
    x = x < low ? low : x;
    return x > high ? high : x;
}
}

OFFPISTE_ENTRY(keep_within)(int first, int last, const Bounds& s, const float* controls, float* kept) {
    const long length = (long)s.steps * s.columns;
    Vectors before(s.columns), rows(4 * s.columns); /* four steps at once */
    for (int at = first * CHUNK; at < last * CHUNK && at < s.count; at += OFFPISTE_WIDTH) {
        const Block b = block_at(at, s.count);
        for (int u = 0; u < s.columns; u++) before[u] = all_lanes(s.previous[u]);
        for (int t = 0; t < s.steps; t += 4) {
            const int count = (s.steps - t < 4 ? s.steps - t : 4) * s.columns;
            load_rows(controls, b, length, (long)t * s.columns, count, rows);
            for (int k = 0; k < count; k++) {
                const int u = k % s.columns;
                const offpiste_real was = before[u];
                offpiste_real value = clamped(rows[k], all_lanes(s.low[u]), all_lanes(s.high[u]));
                if (t > 0 || k >= s.columns || !s.free) {
                    value = clamped(value, was - s.change[u], was + s.change[u]);
                    value = was == was ? value : was;
                }
                before[u] = rows[k] = value;
            }
            store_rows(rows, b, length, (long)t * s.columns, count, kept);
        }
    }
}
