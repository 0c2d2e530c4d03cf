/* One step of a model for the lanes of a vector, and its adjoint: the printed physics between networks of any size
   (dynamics/lstm.py). Structs are filled by dynamics/kernels/structures.py. */

struct Network {
    int inputs, width, outputs;  /* width and outputs: multiples of four */
    int first_output;            /* row of the workspace */
    int first_unit;              /* among the hidden units of all networks */
    const int* rows;             /* of the workspace, of its inputs */
    const float *mean, *inverse_scale, *low, *high;
    const float* gates;  /* [hidden before, inputs, 1][4 HIDDEN] */
    const float* inner;  /* [inputs, 1, hidden after][width] */
    const float* outer;  /* [width, 1][outputs] */
};

struct Model {
    const float* constants;
    const Network* networks;
    const int* control_rows;      /* row of each column of the controls, or -1 where the log lacks it */
    const float* absent_controls; /* what stands for each control that kernels know */
    int network_count, units, codes, columns;
    int absent;     /* bit k: number k of a state was never measured */
    int lags_only;  /* actuators alone, along a recorded speed */
};

OFFPISTE_INLINE int state_size(const Model& m) { return OFFPISTE_MOVED + 2 * m.units; }
OFFPISTE_INLINE int workspace_size(const Model& m) { return OFFPISTE_ROWS + m.codes; }
OFFPISTE_INLINE bool is_absent(const Model& m, int k) { return m.absent >> k & 1; }

/* What a network's step computes and its adjoint reads, one after another; `bars` alike for adjoints. */
struct Activations {
    offpiste_real *before, *seen, *layer, *after, *beyond, *cell, *outputs;
    offpiste_real trust;
};
struct Bars {
    offpiste_real *gates, *layer, *outer, *inputs;
};

enum { MOST_NETWORKS = 3, GATES = 4 * OFFPISTE_HIDDEN, CELL = 7 };

OFFPISTE_INLINE int activation_size(const Network& n) {
    return (2 + CELL) * OFFPISTE_HIDDEN + 2 * n.inputs + n.width + n.outputs;
}
OFFPISTE_INLINE int bars_size(const Network& n) { return GATES + n.width + n.outputs + n.inputs; }

OFFPISTE_INLINE Activations activations_at(const Network& n, offpiste_real* at) {
    Activations a;
    a.before = at;
    a.seen = a.before + OFFPISTE_HIDDEN;
    a.layer = a.seen + n.inputs;
    a.after = a.layer + n.width;
    a.beyond = a.after + OFFPISTE_HIDDEN;
    a.cell = a.beyond + n.inputs;
    a.outputs = a.cell + CELL * OFFPISTE_HIDDEN;
    a.trust = offpiste_real{};
    return a;
}
OFFPISTE_INLINE Bars bars_at(const Network& n, offpiste_real* at) {
    return {at, at + GATES, at + GATES + n.width, at + GATES + n.width + n.outputs};
}

static __attribute__((unused)) void correct(
    const Network& n, offpiste_real* w, offpiste_real* hidden, offpiste_real* memory, Activations& a) {
    enum { H = OFFPISTE_HIDDEN };
    offpiste_real gates[GATES], distance = {};
    for (int k = 0; k < n.inputs; k++) {
        const offpiste_real z = (w[n.rows[k]] - n.mean[k]) * n.inverse_scale[k];
        const offpiste_real high = all_lanes(n.high[k]), low = all_lanes(n.low[k]), under = z < high ? z : high;
        a.seen[k] = under > low ? under : low;
        a.beyond[k] = z - a.seen[k];
        distance += a.beyond[k] * a.beyond[k];
    }
    a.trust = 1.0f / (1.0f + OFFPISTE_FADE * distance);
    const float* bias = n.gates + (H + n.inputs) * GATES;
    for (int i = 0; i < GATES; i++) gates[i] = all_lanes(bias[i]);
    for (int k = 0; k < H; k++) a.before[k] = hidden[k];
    add_product(n.gates, GATES, a.before, H + n.inputs, gates); /* `before` and `seen` are neighbours */
    for (int i = 0; i < H; i++) {
        offpiste_real* cell = a.cell + CELL * i;
        for (int k = 0; k < 4; k++) cell[k] = gates[k * H + i];
        cell[4] = memory[i];
        offpiste_cell(cell);
        a.after[i] = hidden[i] = cell[5];
        memory[i] = cell[6];
    }
    bias = n.inner + n.inputs * n.width;
    for (int i = 0; i < n.width; i++) a.layer[i] = all_lanes(bias[i]);
    add_product(n.inner, n.width, a.seen, n.inputs, a.layer);
    add_product(bias + n.width, n.width, a.after, H, a.layer);
    for (int i = 0; i < n.width; i++) a.layer[i] = offpiste_tanh(a.layer[i]);
    bias = n.outer + n.width * n.outputs;
    for (int i = 0; i < n.outputs; i++) a.outputs[i] = all_lanes(bias[i]);
    add_product(n.outer, n.outputs, a.layer, n.width, a.outputs);
    for (int i = 0; i < n.outputs; i++) w[n.first_output + i] = a.outputs[i] *= a.trust;
}

/* Adds adjoints of the inputs to w_bar; hidden_bar, memory_bar: after the step, and then before it. */
static __attribute__((unused)) void correct_adjoint(
    const Network& n, const Activations& a, offpiste_real* w_bar, offpiste_real* hidden_bar,
    offpiste_real* memory_bar, const Bars& bar) {
    enum { H = OFFPISTE_HIDDEN };
    offpiste_real trust_bar = {}; /* of the trust's logarithm */
    for (int i = 0; i < n.outputs; i++) {
        trust_bar += w_bar[n.first_output + i] * a.outputs[i];
        bar.outer[i] = w_bar[n.first_output + i] * a.trust;
    }
    for (int k = 0; k < n.width; k++) bar.layer[k] = offpiste_real{};
    add_transposed(n.outer, n.outputs, bar.outer, n.width, bar.layer);
    for (int k = 0; k < n.width; k++) bar.layer[k] *= 1.0f - a.layer[k] * a.layer[k];
    add_transposed(n.inner + (n.inputs + 1) * n.width, n.width, bar.layer, H, hidden_bar);
    for (int i = 0; i < H; i++) {
        offpiste_real cell_bar[CELL] = {};
        cell_bar[5] = hidden_bar[i];
        cell_bar[6] = memory_bar[i];
        offpiste_cell_adjoint(a.cell + CELL * i, cell_bar);
        for (int k = 0; k < 4; k++) bar.gates[k * H + i] = cell_bar[k];
        memory_bar[i] = cell_bar[4];
        hidden_bar[i] = offpiste_real{};
    }
    add_transposed(n.gates, GATES, bar.gates, H, hidden_bar);
    for (int k = 0; k < n.inputs; k++) bar.inputs[k] = offpiste_real{};
    add_transposed(n.gates + H * GATES, GATES, bar.gates, n.inputs, bar.inputs);
    add_transposed(n.inner, n.width, bar.layer, n.inputs, bar.inputs);
    for (int k = 0; k < n.inputs; k++) {
        const offpiste_real inner = a.beyond[k] == 0.0f ? bar.inputs[k] : offpiste_real{};
        w_bar[n.rows[k]] +=
            (inner - 2.0f * OFFPISTE_FADE * a.beyond[k] * a.trust * trust_bar) * n.inverse_scale[k];
    }
}

/* What stands for controls that the log lacks; nothing overwrites it. */
OFFPISTE_INLINE void begin_workspace(const Model& m, offpiste_real* w) {
    for (int k = 0; k < OFFPISTE_KNOWN_CONTROLS; k++) w[OFFPISTE_FIRST_CONTROL + k] = all_lanes(m.absent_controls[k]);
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

OFFPISTE_INLINE void load_controls(
    const Model& m, const float* controls, const Block& b, int steps, int t, offpiste_real* w) {
    offpiste_real columns[OFFPISTE_KNOWN_CONTROLS];
    load_rows(controls, b, (long)steps * m.columns, (long)t * m.columns, m.columns, columns);
    for (int k = 0; k < m.columns; k++)
        if (m.control_rows[k] >= 0) w[m.control_rows[k]] = columns[k];
}

OFFPISTE_INLINE void load_start(const Model& m, const float* start, const Block& b, offpiste_real* state) {
    load_rows(start, b, state_size(m), 0, state_size(m), state);
    for (int k = 0; k < OFFPISTE_MOVED; k++)
        if (is_absent(m, k)) state[k] = offpiste_real{};
}

/* One step: state (STEPPED, hidden units, cells) before, and then after. Controls, normals, unknown ones and codes are
   in the workspace; with lags_only the controls and the speed. */
OFFPISTE_INLINE void step(const Model& m, offpiste_real* w, offpiste_real* state, Activations* a) {
    for (int k = m.lags_only ? OFFPISTE_STATES : 0; k < OFFPISTE_MOVED; k++) w[k] = state[k];
    if (!m.lags_only) offpiste_sense(w, m.constants);
    for (int k = 0; k < m.network_count; k++) {
        const Network& n = m.networks[k];
        offpiste_real* hidden = state + OFFPISTE_MOVED + n.first_unit;
        correct(n, w, hidden, hidden + m.units, a[k]);
    }
    if (m.lags_only) offpiste_actuate(w, m.constants);
    else offpiste_advance(w, m.constants);
    for (int k = m.lags_only ? OFFPISTE_STATES : 0; k < OFFPISTE_MOVED; k++)
        if (!is_absent(m, k)) state[k] = w[OFFPISTE_NEXT + k];
}

/* state_bar: after the step, and then before it. c_bar: of the constants that learn, added to. */
OFFPISTE_INLINE void step_adjoint(
    const Model& m, const offpiste_real* w, const Activations* a, offpiste_real* state_bar, offpiste_real* w_bar,
    offpiste_real* c_bar, const Bars* bars) {
    for (int k = 0; k < workspace_size(m); k++) w_bar[k] = offpiste_real{};
    for (int k = 0; k < OFFPISTE_MOVED; k++) w_bar[OFFPISTE_NEXT + k] = state_bar[k];
    if (m.lags_only) offpiste_actuate_adjoint(w, m.constants, w_bar, c_bar);
    else offpiste_advance_adjoint(w, m.constants, w_bar, c_bar);
    for (int k = 0; k < m.network_count; k++) {
        const Network& n = m.networks[k];
        offpiste_real* hidden = state_bar + OFFPISTE_MOVED + n.first_unit;
        correct_adjoint(n, a[k], w_bar, hidden, hidden + m.units, bars[k]);
    }
    if (!m.lags_only) offpiste_sense_adjoint(w, m.constants, w_bar, c_bar);
    for (int k = 0; k < OFFPISTE_MOVED; k++) state_bar[k] = w_bar[k];
}
