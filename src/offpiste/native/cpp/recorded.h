/* Rollouts over recorded ground, and back. A chunk is CHUNK windows, whose adjoints are summed before those of others,
   so that sums do not depend on the number of threads. */

namespace {
enum { KEPT = 8 };

struct Record {
    int batch, steps;
    const float* start;          /* [batch][state] */
    const float* controls;       /* [batch][steps][columns] */
    const float* normals;        /* [batch][steps][4][3] */
    const unsigned char* known;  /* [batch][steps][4] */
    const float* codes;          /* [batch][steps][codes] */
    const float* speed;          /* [batch][steps], with lags_only */
};

/* Adjoints of gates, inner and outer weights of each network, by chunk: null where frozen. */
struct Learning {
    float* matrices[MOST_NETWORKS][3];
};

/* What is given at step t. */
OFFPISTE_INLINE void load_given(const Model& m, const Record& r, const Block& b, int t, offpiste_real* w) {
    load_controls(m, r.controls, b, r.steps, t, w);
    if (m.lags_only) {
        load_rows(r.speed, b, r.steps, t, 1, w + OFFPISTE_SPEED);
        return;
    }
    offpiste_real normals[12];
    load_rows(r.normals, b, 12L * r.steps, 12L * t, 12, normals);
    for (int k = 0; k < 3; k++)
        w[OFFPISTE_NORMAL + k] = 0.25f * (normals[k] + normals[3 + k] + normals[6 + k] + normals[9 + k]);
    for (int i = 0; i < OFFPISTE_WIDTH; i++) {
        const unsigned char* four = r.known + (b.window[i] * r.steps + t) * 4;
        w[OFFPISTE_UNKNOWN][i] = 1.0f - 0.25f * (four[0] + four[1] + four[2] + four[3]);
    }
    load_rows(r.codes, b, (long)m.codes * r.steps, (long)m.codes * t, m.codes, w + OFFPISTE_ROWS);
}

/* States and actuators after step t; absent actuators stay as they started. */
OFFPISTE_INLINE void store_moved(
    const Model& m, const float* start, const offpiste_real* state, const Block& b, int steps, int t, float* states,
    float* actuators) {
    enum { A = OFFPISTE_MOVED - OFFPISTE_STATES };
    if (states) store_rows(state, b, (long)OFFPISTE_STATES * steps, (long)OFFPISTE_STATES * t, OFFPISTE_STATES, states);
    store_rows(state + OFFPISTE_STATES, b, (long)A * steps, (long)A * t, A, actuators);
    for (int k = 0; k < A; k++)
        for (int i = 0; i < b.inside && is_absent(m, OFFPISTE_STATES + k); i++)
            actuators[(b.window[i] * steps + t) * A + k] = start[b.window[i] * state_size(m) + OFFPISTE_STATES + k];
}

/* Records of activations and adjoints of KEPT steps of one network, which its weights' adjoints are products of. */
struct Gradient {
    const Network* n;
    float* const* matrices;       /* as in Learning */
    offpiste_real *record, *sums; /* KEPT x (x, bars); sums of the three matrices */
    int length, sizes[3];
};

/* Without memory for record and sums. */
OFFPISTE_INLINE Gradient gradient_of(const Network& n, float* const* matrices) {
    const int length = 2 * OFFPISTE_HIDDEN + n.inputs + 2 * n.width + GATES + n.outputs + 1;
    const int seen = OFFPISTE_HIDDEN + n.inputs + 1;
    return {&n, matrices, nullptr, nullptr, length, {seen * GATES, seen * n.width, (n.width + 1) * n.outputs}};
}
OFFPISTE_INLINE long gradient_size(const Gradient& g) {
    return (long)KEPT * g.length + g.sizes[0] + g.sizes[1] + g.sizes[2];
}
OFFPISTE_INLINE bool learns(const Gradient& g) { return g.matrices[0] || g.matrices[1] || g.matrices[2]; }

/* Before, seen, 1, after, layer; then bars of gates, layer and outputs. */
OFFPISTE_INLINE void keep_record(const Gradient& g, const Activations& a, const Bars& bar, int slot) {
    const Network& n = *g.n;
    offpiste_real* to = g.record + slot * g.length;
    for (int k = 0; k < OFFPISTE_HIDDEN + n.inputs; k++) *to++ = a.before[k];
    *to++ = all_lanes(1.0f);
    for (int k = 0; k < OFFPISTE_HIDDEN; k++) *to++ = a.after[k];
    for (int k = 0; k < n.width; k++) *to++ = a.layer[k];
    for (int k = 0; k < GATES + n.width + n.outputs; k++) *to++ = bar.gates[k];
}

void add_records(const Gradient& g, int steps) {
    enum { H = OFFPISTE_HIDDEN };
    const Network& n = *g.n;
    const offpiste_real *before = g.record, *seen = before + H, *one = seen + n.inputs, *layer = one + 1 + H;
    const offpiste_real *gates = layer + n.width, *inner = gates + GATES, *outer = inner + n.width;
    offpiste_real* sums = g.sums;
    if (g.matrices[0]) add_outer(before, H + n.inputs + 1, gates, GATES, g.length, steps, sums);
    sums += g.sizes[0];
    if (g.matrices[1]) add_outer(seen, n.inputs + 1 + H, inner, n.width, g.length, steps, sums);
    sums += g.sizes[1];
    if (g.matrices[2]) {
        add_outer(layer, n.width, outer, n.outputs, g.length, steps, sums);
        add_outer(one, 1, outer, n.outputs, g.length, steps, sums + n.width * n.outputs);
    }
}

OFFPISTE_INLINE void store_sums(offpiste_real* sums, int count, float* to) {
    for (int k = 0; k < count; k++) {
        if (to) to[k] = sum_of_lanes(sums[k]);
        sums[k] = offpiste_real{};
    }
}

void store_gradient(const Gradient& g, int chunk) {
    offpiste_real* sums = g.sums;
    for (int k = 0; k < 3; sums += g.sizes[k++])
        store_sums(sums, g.sizes[k], g.matrices[k] ? g.matrices[k] + (long)chunk * g.sizes[k] : nullptr);
}
}

/* tape: states before each step and after the last, [blocks][steps + 1][state] vectors; or null. */
OFFPISTE_ENTRY(forward)(
    int first, int last, const Model& m, const Record& r, float* tape, float* states, float* actuators) {
    const int size = state_size(m);
    Vectors w(workspace_size(m)), state(size), held(activations_total(m));
    Activations a[MOST_NETWORKS];
    place_activations(m, held, a);
    begin_workspace(m, w);
    for (long block = (long)first * CHUNK / OFFPISTE_WIDTH; block * OFFPISTE_WIDTH < (long)last * CHUNK; block++) {
        if (block * OFFPISTE_WIDTH >= r.batch) break;
        const Block b = block_at(block * OFFPISTE_WIDTH, r.batch);
        offpiste_stored* kept = tape ? (offpiste_stored*)tape + block * (r.steps + 1) * size : nullptr;
        load_start(m, r.start, b, state);
        for (int t = 0; t < r.steps; t++) {
            if (kept)
                for (int k = 0; k < size; k++) *kept++ = state[k];
            load_given(m, r, b, t, w);
            step(m, w, state, a);
            store_moved(m, r.start, state, b, r.steps, t, states, actuators);
        }
    }
}

/* states_bar, actuators_bar: of the results. start_bar, codes_bar: to fill, like start and codes (or null).
   c_bar: of the constants that learn, by chunk. */
OFFPISTE_ENTRY(backward)(
    int first, int last, const Model& m, const Record& r, const float* tape, const float* states_bar,
    const float* actuators_bar, float* start_bar, float* codes_bar, float* c_bar, const Learning& learning) {
    enum { A = OFFPISTE_MOVED - OFFPISTE_STATES };
    const int size = state_size(m), constants = m.lags_only ? OFFPISTE_LAG_CONSTANTS : OFFPISTE_LEARNED;
    Gradient gradients[MOST_NETWORKS];
    long bars_total = 0, gradients_total = 0;
    for (int k = 0; k < m.network_count; k++) {
        gradients[k] = gradient_of(m.networks[k], learning.matrices[k]);
        bars_total += bars_size(m.networks[k]);
        gradients_total += gradient_size(gradients[k]);
    }
    Vectors w(workspace_size(m)), w_bar(workspace_size(m)), state(size), bar(size), c_sums(constants);
    Vectors held(activations_total(m)), held_bars(bars_total), held_gradients(gradients_total);
    Activations a[MOST_NETWORKS];
    Bars bars[MOST_NETWORKS];
    place_activations(m, held, a);
    offpiste_real *next_bars = held_bars, *next = held_gradients;
    for (int k = 0; k < m.network_count; k++) {
        bars[k] = bars_at(m.networks[k], next_bars);
        next_bars += bars_size(m.networks[k]);
        gradients[k].record = next;
        gradients[k].sums = next + KEPT * gradients[k].length;
        next += gradient_size(gradients[k]);
    }
    begin_workspace(m, w);
    for (int chunk = first; chunk < last; chunk++) {
        for (int begin = chunk * CHUNK; begin < (chunk + 1) * CHUNK && begin < r.batch; begin += OFFPISTE_WIDTH) {
            const Block b = block_at(begin, r.batch);
            const offpiste_stored* kept = (const offpiste_stored*)tape + (long)begin / OFFPISTE_WIDTH * (r.steps + 1) * size;
            int slot = 0;
            for (int k = 0; k < size; k++) bar[k] = offpiste_real{};
            for (int t = r.steps - 1; t >= 0; t--) {
                offpiste_real seed[OFFPISTE_MOVED];
                if (states_bar)
                    load_rows(states_bar, b, (long)OFFPISTE_STATES * r.steps, (long)OFFPISTE_STATES * t, OFFPISTE_STATES, seed);
                else
                    for (int k = 0; k < OFFPISTE_STATES; k++) seed[k] = offpiste_real{};
                load_rows(actuators_bar, b, (long)A * r.steps, (long)A * t, A, seed + OFFPISTE_STATES);
                for (int k = 0; k < OFFPISTE_MOVED; k++) bar[k] += b.weight * seed[k];
                for (int k = 0; k < size; k++) state[k] = kept[(long)t * size + k];
                load_given(m, r, b, t, w);
                step(m, w, state, a);
                step_adjoint(m, w, a, bar, w_bar, c_sums, bars);
                if (codes_bar)
                    store_rows(w_bar + OFFPISTE_ROWS, b, (long)m.codes * r.steps, (long)m.codes * t, m.codes, codes_bar);
                for (int k = 0; k < m.network_count; k++)
                    if (learns(gradients[k])) keep_record(gradients[k], a[k], bars[k], slot);
                if (++slot == KEPT || t == 0) {
                    for (int k = 0; k < m.network_count; k++)
                        if (learns(gradients[k])) add_records(gradients[k], slot);
                    slot = 0;
                }
            }
            store_rows(bar, b, size, 0, size, start_bar);
        }
        store_sums(c_sums, constants, c_bar + (long)chunk * constants);
        for (int k = 0; k < m.network_count; k++)
            if (learns(gradients[k])) store_gradient(gradients[k], chunk);
    }
}
