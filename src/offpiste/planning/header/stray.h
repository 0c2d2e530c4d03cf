/* How far errors of position reach along and across the heading. Lanes that
   share a sample share the hidden units. OFFPISTE_STRAY: how many there are; 0 where plans cost what is predicted. */
#if OFFPISTE_STRAY
#define OFFPISTE_STRAY_GIVEN (6 + OFFPISTE_CONTROLS)
#define OFFPISTE_STRAY_INPUTS (OFFPISTE_STRAY_GIVEN + OFFPISTE_CODES / 4)

/* A spread, its standardisation folded into inner. start: variance of the velocity at the start; reach: scales that
   count, times the spread's factor. */
typedef struct {
    float inner[OFFPISTE_STRAY][OFFPISTE_STRAY_INPUTS], bias[OFFPISTE_STRAY], outer[2][OFFPISTE_STRAY], outer_bias[2];
    float start[2], reach;
} offpiste_stray_weights;

/* Variance and reach of the velocity, along and across. */
typedef struct {
    float variance[2], velocity[2];
} offpiste_stray;

OFFPISTE_FN float offpiste_softplus(float x) { return (x > 0.0f ? x : 0.0f) + log1pf(expf(x > 0.0f ? -x : x)); }

/* At the start the place is certain. */
OFFPISTE_FN offpiste_stray offpiste_begin_stray(const offpiste_stray_weights* s, offpiste_values* values) {
    const offpiste_stray stray = {{s->start[0], s->start[1]}, {0.0f, 0.0f}};
    values->stray[0] = values->stray[1] = 0.0f;
    return stray;
}

/* What the network reads of a state, the controls from there on and the ground under it (spread.spread_inputs). */
OFFPISTE_FN void offpiste_see_stray(
    const float* state, const offpiste_given* given, const offpiste_values* values, float* seen) {
    const float c = values->cos_yaw, s = values->sin_yaw, known = 4.0f * (1.0f - given->unknown);
    const float to_known = 4.0f / (known > 1.0f ? known : 1.0f); /* given has means over all wheels */
    const float nx = to_known * given->normal[0], ny = to_known * given->normal[1], across = s * nx - c * ny;
    seen[0] = sqrtf(state[3] * state[3] + state[4] * state[4]);
    seen[1] = fabsf(state[5]);
    seen[2] = fabsf(state[3] * state[5]);
    seen[3] = -(c * nx + s * ny);
    seen[4] = fabsf(across);
    seen[5] = given->unknown;
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_CONTROLS; k++) seen[6 + k] = given->control[k];
#if OFFPISTE_CODES
    OFFPISTE_UNROLL
    for (int e = 0; e < OFFPISTE_CODE; e++) {
        const float* code = given->codes + e;
        seen[OFFPISTE_STRAY_GIVEN + e] =
            0.25f * (code[0] + code[OFFPISTE_CODE] + code[2 * OFFPISTE_CODE] + code[3 * OFFPISTE_CODE]);
    }
#endif
}

/* Variance and reach of the velocity for the next OFFPISTE_STRAY_EVERY steps. */
OFFPISTE_FN void offpiste_sense_stray(
    const offpiste_stray_weights* w, const float* state, const offpiste_given* given, const offpiste_values* values,
    offpiste_stray* stray) {
    float seen[OFFPISTE_STRAY_INPUTS], out[2] = {0.0f, 0.0f};
    offpiste_see_stray(state, given, values, seen);
    for (int h = OFFPISTE_LANE; h < OFFPISTE_STRAY; h += OFFPISTE_LANES) {
        float unit = w->bias[h];
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_STRAY_INPUTS; k++) unit += w->inner[h][k] * seen[k];
        unit = offpiste_tanh(unit);
        out[0] += w->outer[0][h] * unit;
        out[1] += w->outer[1][h] * unit;
    }
    OFFPISTE_UNROLL
    for (int k = 0; k < 2; k++) {
        const float rate = offpiste_softplus(offpiste_over_lanes(out[k]) + w->outer_bias[k]);
        stray->variance[k] += rate * rate * OFFPISTE_STRAY_INTERVAL;
        stray->velocity[k] = w->reach * sqrtf(stray->variance[k]);
    }
}

/* The reach after one more step. */
OFFPISTE_FN void offpiste_move_stray(const offpiste_stray* stray, offpiste_values* values) {
    values->stray[0] += stray->velocity[0] * OFFPISTE_STRAY_STEP;
    values->stray[1] += stray->velocity[1] * OFFPISTE_STRAY_STEP;
}
#endif
