/* Rollouts of sampled controls on a map, with their costs. Terrain under the wheels after a step is read once: the
   step's cost reads it, and so does the next step. */

namespace {
/* Spread of the predictions: how far errors of position reach (uncertainty/spread.py), its standardisation folded into
   the first layer. hidden: a multiple of four; 0 where plans cost what is predicted. */
struct Stray {
    int hidden, inputs, every;
    const float *inner, *bias;  /* [inputs][hidden] */
    const float *outer;         /* [hidden][4], of which two count */
    float outer_bias[2], start[2], reach, interval, dt;
};

/* Where a layer is read, and its value off the map: NaN for that of the nearest cell. */
enum { MEAN_OF_WHEELS, LEAST_OF_WHEELS, POSE_POINT };

struct Situation {
    Grid ground, costs;
    float wheels[4][2], control[3];
    const float* start;  /* [state] */
    const float *slope, *codes, *missing;
    const float *layers, *outside, *numbers;
    const int* reads;
    int layer_count, one_grid; /* one_grid: whether both grids are equal */
    Stray stray;
};

struct Samples {
    int count, steps, columns, kept;
    const float* controls; /* [count][steps][columns] */
    float* costs;          /* [count] */
    float* states;         /* the first `kept` numbers of the state after each step, [count][steps][kept], or null */
};

/* Layers first ... first + count - 1 of cells. */
OFFPISTE_INLINE void gather_layers(
    const Situation& s, offpiste_whole cell, offpiste_whole inside, int first, int count, offpiste_real* out) {
    to_lanes(s.layers + first, Places(cell * s.layer_count), count, out);
    for (int k = 0; k < count; k++)
        if (s.outside[first + k] == s.outside[first + k]) out[k] = inside ? out[k] : all_lanes(s.outside[first + k]);
}

/* First and number of the layers that are read at wheels, or at the pose point; four at once where there are four. */
struct Span {
    int first, count;
};

OFFPISTE_INLINE Span span_of(const Situation& s, bool at_pose) {
    int first = s.layer_count, end = 0;
    for (int k = 0; k < s.layer_count; k++)
        if ((s.reads[k] == POSE_POINT) == at_pose) {
            first = first < k ? first : k;
            end = k + 1;
        }
    if (end <= first) return {0, 0};
    int count = (end - first + 3) / 4 * 4;
    if (count > s.layer_count) count = end - first;
    if (first + count > s.layer_count) first = s.layer_count - count;
    return {first, count};
}

OFFPISTE_INLINE void sample_terrain(
    const Model& m, const Situation& s, const offpiste_real* state, const Span* spans, offpiste_real* w,
    offpiste_values& v) {
    const int size = m.codes / 4;
    const offpiste_real last_x = all_lanes(s.ground.columns - 1.0f), last_y = all_lanes(s.ground.rows - 1.0f);
    const int columns = s.ground.columns > 2 ? s.ground.columns : 2; /* of the slope: a single one is there twice */
    const int up = s.ground.rows > 1 ? 2 * columns : 0;
    Ground ground = {};
    offpiste_real read[OFFPISTE_LAYERS + 4];
    v.cos_yaw = offpiste_cos(state[2]);
    v.sin_yaw = offpiste_sin(state[2]);
    for (int k = 0; k < s.layer_count; k++) v.layers[k] = all_lanes(s.reads[k] == LEAST_OF_WHEELS ? INFINITY : 0.0f);
    for (int wheel = 0; wheel < 4; wheel++) {
        const float wx = s.wheels[wheel][0], wy = s.wheels[wheel][1];
        const offpiste_real px = state[0] + v.cos_yaw * wx - v.sin_yaw * wy;
        const offpiste_real py = state[1] + v.sin_yaw * wx + v.cos_yaw * wy;
        const Place p = place_on(s.ground, px, py);
        const offpiste_whole cell = nearest(p, s.ground.columns);
        offpiste_real x0, y0, slope[8];
        corner_of(p, last_x, last_y, &x0, &y0);
        const Places corner((whole(y0) * columns + whole(x0)) * 2);
        to_lanes(s.slope, corner, 4, slope);
        to_lanes(s.slope + up, corner, 4, slope + 4);
        add_wheel(ground, slope, p.x - x0, p.y - y0, p.inside);
        if (size) {
            offpiste_real* code = w + OFFPISTE_ROWS + wheel * size;
            to_lanes(s.codes, Places(cell * size), size, code);
            for (int k = 0; k < size; k++) code[k] = p.inside ? code[k] : all_lanes(s.missing[k]);
        }
        if (s.one_grid) gather_layers(s, cell, p.inside, spans[0].first, spans[0].count, read);
        else {
            const Place q = place_on(s.costs, px, py);
            gather_layers(s, nearest(q, s.costs.columns), q.inside, spans[0].first, spans[0].count, read);
        }
        for (int k = 0; k < spans[0].count; k++) {
            const int layer = spans[0].first + k;
            if (s.reads[layer] == MEAN_OF_WHEELS) v.layers[layer] += 0.25f * read[k];
            if (s.reads[layer] == LEAST_OF_WHEELS) v.layers[layer] = at_most(read[k], v.layers[layer]);
        }
    }
    const Place pose = place_on(s.costs, state[0], state[1]);
    gather_layers(s, nearest(pose, s.costs.columns), pose.inside, spans[1].first, spans[1].count, read);
    for (int k = 0; k < spans[1].count; k++)
        if (s.reads[spans[1].first + k] == POSE_POINT) v.layers[spans[1].first + k] = read[k];
    store_ground(ground, w);
}

struct Reach {
    offpiste_real variance[2], velocity[2]; /* of the velocity, along and across */
};

/* What the spread's network reads: `spread.MOTION` before a step, controls, mean code of the wheels. */
OFFPISTE_INLINE void see_stray(
    const Model& m, const offpiste_real* state, const offpiste_real* w, const offpiste_values& v, offpiste_real* seen) {
    const offpiste_real unknown = w[OFFPISTE_UNKNOWN], known = 4.0f * (1.0f - unknown);
    const offpiste_real to_known = 4.0f / offpiste_maximum(known, 1.0f); /* the workspace has means over all wheels */
    const offpiste_real nx = to_known * w[OFFPISTE_NORMAL], ny = to_known * w[OFFPISTE_NORMAL + 1];
    const int size = m.codes / 4;
    seen[0] = square_root(state[3] * state[3] + state[4] * state[4]);
    seen[1] = magnitude(state[5]);
    seen[2] = magnitude(state[3] * state[5]);
    seen[3] = -(v.cos_yaw * nx + v.sin_yaw * ny);
    seen[4] = magnitude(v.sin_yaw * nx - v.cos_yaw * ny);
    seen[5] = unknown;
    seen += 6;
    for (int k = 0; k < OFFPISTE_KNOWN_CONTROLS; k++) *seen++ = w[OFFPISTE_FIRST_CONTROL + k];
    for (int k = 0; k < size; k++) {
        const offpiste_real* code = w + OFFPISTE_ROWS + k;
        *seen++ = 0.25f * (code[0] + code[size] + code[2 * size] + code[3 * size]);
    }
}

/* The variance grows for the next `every` steps. seen, layer: for inputs and hidden units. */
OFFPISTE_INLINE void grow_reach(
    const Stray& s, const offpiste_real* seen, offpiste_real* layer, Reach& reach) {
    offpiste_real out[4] = {};
    for (int i = 0; i < s.hidden; i++) layer[i] = all_lanes(s.bias[i]);
    add_product(s.inner, s.hidden, seen, s.inputs, layer);
    for (int i = 0; i < s.hidden; i++) layer[i] = offpiste_tanh(layer[i]);
    add_product(s.outer, 4, layer, s.hidden, out);
    for (int k = 0; k < 2; k++) {
        offpiste_real rate = out[k] + s.outer_bias[k];
        for (int i = 0; i < OFFPISTE_WIDTH; i++) { /* softplus */
            const float x = rate[i];
            rate[i] = (x > 0.0f ? x : 0.0f) + log1pf(expf(x > 0.0f ? -x : x));
        }
        reach.variance[k] += rate * rate * s.interval;
        reach.velocity[k] = s.reach * square_root(reach.variance[k]);
    }
}
}

OFFPISTE_ENTRY(plan)(int first, int last, const Model& m, const Situation& s, const Samples& samples) {
    const Span spans[2] = {span_of(s, false), span_of(s, true)};
    const int size = state_size(m);
    Vectors w(workspace_size(m)), state(size), held(activations_total(m)), seen(s.stray.inputs), layer(s.stray.hidden);
    Activations a[MOST_NETWORKS];
    place_activations(m, held, a);
    begin_workspace(m, w);
    for (int at = first * CHUNK; at < last * CHUNK && at < samples.count; at += OFFPISTE_WIDTH) {
        const Block b = block_at(at, samples.count);
        offpiste_real total = {}, command[3], before[3], four_steps[4 * OFFPISTE_KNOWN_CONTROLS];
        offpiste_values v = {};
        Reach reach = {};
        for (int k = 0; k < 3; k++) before[k] = all_lanes(s.control[k]);
        for (int k = 0; k < size; k++)
            state[k] = all_lanes(k < OFFPISTE_MOVED && is_absent(m, k) ? 0.0f : s.start[k]);
        for (int k = 0; k < 2; k++) reach.variance[k] = all_lanes(s.stray.start[k]);
        sample_terrain(m, s, state, spans, w, v);
        for (int t = 0; t < samples.steps; t++) {
            if (t % 4 == 0)
                load_rows(
                    samples.controls, b, (long)samples.steps * samples.columns, (long)t * samples.columns,
                    (samples.steps - t < 4 ? samples.steps - t : 4) * samples.columns, four_steps);
            const offpiste_real* columns = four_steps + t % 4 * samples.columns;
            for (int k = 0; k < samples.columns; k++)
                if (m.control_rows[k] >= 0) w[m.control_rows[k]] = columns[k];
            for (int k = 0; k < 3; k++) command[k] = v.control[k] = columns[k];
            if (s.stray.hidden && t % s.stray.every == 0) {
                see_stray(m, state, w, v, seen);
                grow_reach(s.stray, seen, layer, reach);
            }
            v.vx_before = state[3];
            v.vy_before = state[4];
            step(m, w, state, a);
            sample_terrain(m, s, state, spans, w, v);
            for (int k = 0; k < 2; k++) v.stray[k] += reach.velocity[k] * s.stray.dt;
            total += offpiste_control_cost(s.numbers, before, command);
            total += offpiste_motion_cost(s.numbers, state, w + OFFPISTE_NORMAL, &v);
            for (int k = 0; k < 3; k++) before[k] = command[k];
            if (samples.states)
                store_rows(
                    state, b, (long)samples.steps * samples.kept, (long)t * samples.kept, samples.kept, samples.states);
        }
        for (int i = 0; i < b.inside; i++) samples.costs[at + i] = total[i];
    }
}
