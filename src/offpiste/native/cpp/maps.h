/* Rollouts over maps of float16 cells, read under predicted wheels: evaluation and validation. */

namespace {
struct Maps {
    int batch, steps;
    const float *start, *controls; /* as in Record */
    const float* shift;            /* from each window's frame to cell [0, 0] of its map [batch][2] */
    const int* number;             /* of the map of each window */
    const int* last;               /* column and row of the last cell of each map [maps][2] */
    const int* place;              /* of each cell in the lists, -1 where there is none [maps][rows][columns] */
    int rows, columns, cells, stride;
    float resolution, wheels[4][2];
    const unsigned short* slope;    /* [cells][2], the last one unknown */
    const unsigned short* features; /* [cells][stride] */
};

/* A float16 by its bits; what is not finite becomes not a number. */
OFFPISTE_INLINE float widened(unsigned short half) {
    const unsigned rest = half & 0x7FFFu;
    const unsigned bits = (half & 0x8000u) << 16 | (rest >= 0x7C00u ? 0x7FC00000u : rest << 13);
    float value;
    memcpy(&value, &bits, 4);
    return value * 5.192296858534828e33f; /* 2^112 */
}

OFFPISTE_INLINE void read_maps(
    const Maps& m, const Encoder& e, const Block& b, const offpiste_real* state, int codes, offpiste_real* w,
    offpiste_real* a) {
    Ground ground = {};
    offpiste_real shift[2], last[2] = {};
    load_rows(m.shift, b, 2, 0, 2, shift);
    for (int i = 0; i < OFFPISTE_WIDTH; i++)
        for (int k = 0; k < 2; k++) last[k][i] = m.last[2 * m.number[b.window[i]] + k];
    const offpiste_real c = offpiste_cos(state[2]), s = offpiste_sin(state[2]);
    for (int wheel = 0; wheel < 4; wheel++) {
        const float wx = m.wheels[wheel][0], wy = m.wheels[wheel][1];
        const offpiste_real x = (state[0] + c * wx - s * wy + shift[0]) / m.resolution;
        const offpiste_real y = (state[1] + s * wx + c * wy + shift[1]) / m.resolution;
        const Place p = on_grid(x, y, last[0], last[1]);
        offpiste_real x0, y0, slope[8];
        corner_of(p, last[0], last[1], &x0, &y0);
        const offpiste_whole column = whole(x0), row = whole(y0), cell = nearest(p, m.columns);
        offpiste_whole valid = {};
        for (int i = 0; i < OFFPISTE_WIDTH; i++) {
            const int* places = m.place + (long)m.number[b.window[i]] * m.rows * m.columns;
            for (int n = 0; n < 4; n++) {
                const int right = n % 2 && column[i] < last[0][i], up = n > 1 && row[i] < last[1][i];
                const int found = places[(row[i] + up) * m.columns + column[i] + right];
                const unsigned short* from = m.slope + 2L * (found < 0 ? m.cells - 1 : found);
                slope[2 * n][i] = widened(from[0]);
                slope[2 * n + 1][i] = widened(from[1]);
            }
            const int found = p.inside[i] && codes ? places[cell[i]] : -1;
            if (found < 0) continue;
            const unsigned short* from = m.features + (long)found * m.stride;
            int finite = 1;
            for (int k = 0; k < m.stride; k++) finite &= (from[k] & 0x7FFF) < 0x7C00;
            for (int k = 0; k < e.features && finite; k++) a[k][i] = widened(from[k]);
            valid[i] = -finite;
        }
        add_wheel(ground, slope, p.x - x0, p.y - y0, p.inside);
        if (!codes) continue;
        const offpiste_real* code = encode(e, valid, a);
        for (int k = 0; k < codes; k++) w[OFFPISTE_ROWS + wheel * codes + k] = code[k];
    }
    store_ground(ground, w);
}
}

OFFPISTE_ENTRY(forward_on_maps)(
    int first, int last, const Model& m, const Maps& maps, const Encoder& e, float* states, float* actuators) {
    Vectors w(workspace_size(m)), state(state_size(m)), held(activations_total(m)), encoding(encoding_size(e) + 4);
    Activations a[MOST_NETWORKS];
    place_activations(m, held, a);
    begin_workspace(m, w);
    for (int at = first * CHUNK; at < last * CHUNK && at < maps.batch; at += OFFPISTE_WIDTH) {
        const Block b = block_at(at, maps.batch);
        load_start(m, maps.start, b, state);
        for (int t = 0; t < maps.steps; t++) {
            load_controls(m, maps.controls, b, maps.steps, t, w);
            read_maps(maps, e, b, state, m.codes / 4, w, encoding);
            step(m, w, state, a);
            store_moved(m, maps.start, state, b, maps.steps, t, states, actuators);
        }
    }
}
