/* Rollouts over recorded ground, and back. A chunk is CHUNK windows, whose adjoints are summed before those of others,
   so that sums do not depend on the number of threads. */

enum { CHUNK = 32, KEPT = 8, MOST_NETWORKS = 3 };

struct Record {
    int batch, steps;
    const float* start;          /* [batch][state] */
    const float* controls;       /* [batch][steps][columns] */
    const float* normals;        /* [batch][steps][4][3] */
    const unsigned char* known;  /* [batch][steps][4] */
    const float* codes;          /* [batch][steps][codes] */
    const float* speed;          /* [batch][steps], with lags_only */
};

/* Adjoints of networks that learn, by chunk: null where frozen. */
struct Learning {
    float *gates[MOST_NETWORKS], *inner[MOST_NETWORKS], *outer[MOST_NETWORKS];
};

struct Block {
    int first, inside;
    long window[OFFPISTE_WIDTH]; /* lanes behind the batch repeat its last window */
    offpiste_real weight;        /* 1, behind the batch 0 */
};

OFFPISTE_INLINE Block block_at(int first, int batch) {
    Block b;
    b.first = first;
    b.inside = batch - first < OFFPISTE_WIDTH ? batch - first : OFFPISTE_WIDTH;
    for (int i = 0; i < OFFPISTE_WIDTH; i++) {
        b.window[i] = first + i < batch ? first + i : batch - 1;
        b.weight[i] = first + i < batch ? 1.0f : 0.0f;
    }
    return b;
}

OFFPISTE_INLINE void load_rows(const float* rows, const Block& b, long apart, long at, int count, offpiste_real* out) {
    to_lanes([&](int i) { return rows + b.window[i] * apart + at; }, count, out);
}

OFFPISTE_INLINE void store_rows(const offpiste_real* in, const Block& b, long apart, long at, int count, float* rows) {
    float* to[OFFPISTE_WIDTH];
    for (int i = 0; i < OFFPISTE_WIDTH; i++) to[i] = rows + b.window[i] * apart + at;
    from_lanes(in, count, b.inside, to);
}

OFFPISTE_INLINE void load_controls(
    const Model& m, const float* controls, const Block& b, int steps, int t, offpiste_real* w) {
    offpiste_real columns[OFFPISTE_KNOWN_CONTROLS];
    load_rows(controls, b, (long)steps * m.columns, (long)t * m.columns, m.columns, columns);
    for (int k = 0; k < m.columns; k++)
        if (m.control_rows[k] >= 0) w[m.control_rows[k]] = columns[k];
}

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

OFFPISTE_INLINE void load_start(const Model& m, const float* start, const Block& b, offpiste_real* state) {
    load_rows(start, b, state_size(m), 0, state_size(m), state);
    for (int k = 0; k < OFFPISTE_MOVED; k++)
        if (is_absent(m, k)) state[k] = offpiste_real{};
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

OFFPISTE_INLINE long activations_total(const Model& m) {
    long size = 0;
    for (int k = 0; k < m.network_count; k++) size += activation_size(m.networks[k]);
    return size;
}

OFFPISTE_INLINE void place_activations(const Model& m, offpiste_real* at, Activations* a) {
    for (int k = 0; k < m.network_count; k++) {
        a[k] = activations_at(m.networks[k], at);
        at += activation_size(m.networks[k]);
    }
}

/* tape: states before each step and after the last, [blocks][steps + 1][state] vectors; or null. */
static void roll_forward(
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

/* Records of activations and adjoints of KEPT steps of one network, which its weights' adjoints are products of. */
struct Gradient {
    const Network* n;
    float *gates, *inner, *outer;
    offpiste_real *record, *sums; /* KEPT x (x, bars); sums of the three matrices */
    int length;
};

OFFPISTE_INLINE int record_size(const Network& n) {
    return 2 * OFFPISTE_HIDDEN + n.inputs + 2 * n.width + GATES + n.outputs + 1;
}
OFFPISTE_INLINE int gates_size(const Network& n) { return (OFFPISTE_HIDDEN + n.inputs + 1) * GATES; }
OFFPISTE_INLINE int inner_size(const Network& n) { return (OFFPISTE_HIDDEN + n.inputs + 1) * n.width; }
OFFPISTE_INLINE int outer_size(const Network& n) { return (n.width + 1) * n.outputs; }

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

static void add_records(const Gradient& g, int steps) {
    enum { H = OFFPISTE_HIDDEN };
    const Network& n = *g.n;
    const offpiste_real *before = g.record, *seen = before + H, *one = seen + n.inputs, *layer = one + 1 + H;
    const offpiste_real *gates = layer + n.width, *inner = gates + GATES, *outer = inner + n.width;
    offpiste_real* sums = g.sums;
    if (g.gates) add_outer(before, H + n.inputs + 1, gates, GATES, g.length, steps, sums);
    sums += gates_size(n);
    if (g.inner) add_outer(seen, n.inputs + 1 + H, inner, n.width, g.length, steps, sums);
    sums += inner_size(n);
    if (g.outer) {
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

/* states_bar, actuators_bar: of the results. start_bar, codes_bar: to fill, like start and codes (or null).
   c_bar: of the constants that learn, by chunk. */
static void roll_backward(
    int first, int last, const Model& m, const Record& r, const float* tape, const float* states_bar,
    const float* actuators_bar, float* start_bar, float* codes_bar, float* c_bar, const Learning& learning) {
    enum { A = OFFPISTE_MOVED - OFFPISTE_STATES };
    const int size = state_size(m), constants = m.lags_only ? OFFPISTE_LAG_CONSTANTS : OFFPISTE_LEARNED;
    long bars_total = 0, gradients_total = 0;
    for (int k = 0; k < m.network_count; k++) {
        const Network& n = m.networks[k];
        bars_total += bars_size(n);
        gradients_total += KEPT * record_size(n) + gates_size(n) + inner_size(n) + outer_size(n);
    }
    Vectors w(workspace_size(m)), w_bar(workspace_size(m)), state(size), bar(size), c_sums(constants);
    Vectors held(activations_total(m)), held_bars(bars_total), held_gradients(gradients_total);
    Activations a[MOST_NETWORKS];
    Bars bars[MOST_NETWORKS];
    Gradient gradients[MOST_NETWORKS];
    place_activations(m, held, a);
    offpiste_real *next_bars = held_bars, *next = held_gradients;
    int learners = 0;
    for (int k = 0; k < m.network_count; k++) {
        const Network& n = m.networks[k];
        bars[k] = bars_at(n, next_bars);
        next_bars += bars_size(n);
        gradients[k] = {&n, learning.gates[k], learning.inner[k], learning.outer[k], next, next + KEPT * record_size(n),
                        record_size(n)};
        next += KEPT * record_size(n) + gates_size(n) + inner_size(n) + outer_size(n);
        if (learning.gates[k] || learning.inner[k] || learning.outer[k]) learners |= 1 << k;
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
                    if (learners >> k & 1) keep_record(gradients[k], a[k], bars[k], slot);
                if (++slot == KEPT || t == 0) {
                    for (int k = 0; k < m.network_count; k++)
                        if (learners >> k & 1) add_records(gradients[k], slot);
                    slot = 0;
                }
            }
            store_rows(bar, b, size, 0, size, start_bar);
        }
        store_sums(c_sums, constants, c_bar + (long)chunk * constants);
        for (int k = 0; k < m.network_count; k++) {
            if (!(learners >> k & 1)) continue;
            const Gradient& g = gradients[k];
            const int of_gates = gates_size(*g.n), of_inner = inner_size(*g.n), of_outer = outer_size(*g.n);
            store_sums(g.sums, of_gates, g.gates ? g.gates + (long)chunk * of_gates : nullptr);
            store_sums(g.sums + of_gates, of_inner, g.inner ? g.inner + (long)chunk * of_inner : nullptr);
            store_sums(g.sums + of_gates + of_inner, of_outer, g.outer ? g.outer + (long)chunk * of_outer : nullptr);
        }
    }
}
