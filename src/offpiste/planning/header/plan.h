/* Rollouts of sampled controls on a map, with their costs. */

/* Everything of a plan but weights, maps and samples, so that a captured graph finds it at one place. missing comes
   first: GPUs load four codes at once. */
typedef struct {
#if OFFPISTE_CODES
    float missing[OFFPISTE_CODE + (4 - OFFPISTE_CODE % 4) % 4];
#endif
    offpiste_grid ground, costs;
    float wheels[4][2], gear, control[3];
    float outside[OFFPISTE_LAYERS], numbers[OFFPISTE_NUMBERS], start[OFFPISTE_STATE];
#if OFFPISTE_STRAY
    offpiste_stray_weights stray;
#endif
} offpiste_situation;

/* Maps: slope [ny, nx, 2], codes [ny, nx, E] and layers [ny, nx, C] of cells. */
typedef struct {
    const float *slope, *codes, *layers;
} offpiste_maps;

/* What the model reads of the ground under a wheel into normal, unknown and codes, and what the cost reads. */
OFFPISTE_FN void offpiste_sample_wheel(
    const offpiste_situation* s, const offpiste_maps* maps, const float* state, int k, float* normal,
    float* unknown, float* codes, offpiste_values* values) {
    const float wx = s->wheels[k][0], wy = s->wheels[k][1];
    const float px = state[0] + values->cos_yaw * wx - values->sin_yaw * wy;
    const float py = state[1] + values->sin_yaw * wx + values->cos_yaw * wy;
    const offpiste_cell_place place = offpiste_cell_at(&s->ground, px, py);
    const offpiste_cell_place cost = offpiste_cell_at(&s->costs, px, py);
    offpiste_add_normal(&s->ground, maps->slope, place, normal, unknown);
    offpiste_read_wheel_layers(
        maps->layers + OFFPISTE_LAYERS * offpiste_nearest(&s->costs, cost), cost.inside, s->outside, values);
    (void)codes;
#if OFFPISTE_CODES
    offpiste_read_codes(maps->codes, s->missing, offpiste_nearest(&s->ground, place), place.inside, codes);
#endif
}

/* What the model reads of the ground under a state into given, and what the cost reads into values. */
OFFPISTE_FN void offpiste_sample(
    const offpiste_situation* s, const offpiste_maps* maps, const float* state, offpiste_given* given,
    offpiste_values* values) {
    float normal[3] = {0.0f, 0.0f, 0.0f}, unknown = 0.0f;
    values->cos_yaw = offpiste_cos(state[2]);
    values->sin_yaw = offpiste_sin(state[2]);
    offpiste_begin_layers(values);
#if OFFPISTE_CODES
    float* codes = given->codes;
#define OFFPISTE_CODES_OF(k) codes + OFFPISTE_CODE * (k)
#else
#define OFFPISTE_CODES_OF(k) 0
#endif
#if OFFPISTE_LANES > 1 /* a wheel for each */
#if OFFPISTE_CODES
    float own[OFFPISTE_CODE];
    offpiste_sample_wheel(s, maps, state, OFFPISTE_LANE, normal, &unknown, own, values);
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_CODES; k++)
        codes[k] = offpiste_from_lane(own[k % OFFPISTE_CODE], k / OFFPISTE_CODE);
#else
    offpiste_sample_wheel(s, maps, state, OFFPISTE_LANE, normal, &unknown, 0, values);
#endif
    OFFPISTE_UNROLL
    for (int k = 0; k < 3; k++) normal[k] = offpiste_over_lanes(normal[k]);
    unknown = offpiste_over_lanes(unknown);
    offpiste_join_layers(values);
#else
    OFFPISTE_UNROLL
    for (int k = 0; k < 4; k++)
        offpiste_sample_wheel(s, maps, state, k, normal, &unknown, OFFPISTE_CODES_OF(k), values);
#endif
    OFFPISTE_UNROLL
    for (int k = 0; k < 3; k++) given->normal[k] = normal[k];
    given->unknown = unknown;
    {
        const offpiste_cell_place cost = offpiste_cell_at(&s->costs, state[0], state[1]);
        offpiste_read_pose_layers(
            maps->layers + OFFPISTE_LAYERS * offpiste_nearest(&s->costs, cost), cost.inside, s->outside, values);
    }
}

/* controls: [steps, 3, n], throttle, brake, steer. costs: [n], to fill. states: [steps, 6, n], to fill, or null. */
OFFPISTE_KERNEL(
    offpiste_roll_out, const offpiste_params* weights, const offpiste_situation* OFFPISTE_RESTRICT situation,
    const float* OFFPISTE_RESTRICT slope, const float* OFFPISTE_RESTRICT codes, const float* OFFPISTE_RESTRICT layers,
    const float* OFFPISTE_RESTRICT controls, float* OFFPISTE_RESTRICT costs, float* OFFPISTE_RESTRICT states, int steps,
    int n) {
    OFFPISTE_SHARED_PARAMS(params, weights)
    OFFPISTE_EACH_BY_LANES(i, n) {
        const offpiste_maps maps = {slope, codes, layers};
        const offpiste_situation* s = situation;
        float state[OFFPISTE_STATE], before[3], next[3], total = 0.0f;
        offpiste_given given;
        offpiste_values values;
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_STATE; k++) state[k] = s->start[k];
        OFFPISTE_UNROLL
        for (int k = 0; k < 3; k++) before[k] = s->control[k], next[k] = controls[k * n + i];
        offpiste_sample(s, &maps, state, &given, &values);
#if OFFPISTE_STRAY
        offpiste_stray stray = offpiste_begin_stray(&s->stray, &values);
#endif
        for (int t = 0; t < steps; t++) {
            OFFPISTE_FORGET
            OFFPISTE_UNROLL
            for (int k = 0; k < 3; k++) {
                values.control[k] = next[k];
                next[k] = controls[(3 * (t + 1 < steps ? t + 1 : t) + k) * n + i]; /* they come from far */
            }
            OFFPISTE_UNROLL
            for (int k = 0; k < OFFPISTE_CONTROLS; k++) given.control[k] = k < 3 ? values.control[k] : s->gear;
#if OFFPISTE_STRAY
            if (t % OFFPISTE_STRAY_EVERY == 0) offpiste_sense_stray(&s->stray, state, &given, &values, &stray);
            offpiste_move_stray(&stray, &values);
#endif
            values.vx_before = state[3];
            values.vy_before = state[4];
            offpiste_step(params, &given, state);
            offpiste_sample(s, &maps, state, &given, &values);
            total += offpiste_control_cost(s->numbers, before, values.control);
            total += offpiste_motion_cost(s->numbers, state, given.normal, &values);
            OFFPISTE_UNROLL
            for (int k = 0; k < 3; k++) before[k] = values.control[k];
            if (states)
                OFFPISTE_UNROLL
                for (int k = 0; k < 6; k++) states[(6 * t + k) * n + i] = state[k];
        }
        costs[i] = total;
    }
}
