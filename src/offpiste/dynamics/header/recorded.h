/* Rollouts over recorded ground with their tape, and back. All arrays have the window as their last axis, n windows.
   given: [steps, GIVEN, n], the members of offpiste_given in order. tape: [steps + 1, STATE, n], states before each
   step and after the last; the first one is given. */
#define OFFPISTE_GIVEN (OFFPISTE_CONTROLS + 4 + OFFPISTE_CODES + OFFPISTE_TERMS)

OFFPISTE_FN void offpiste_read_given(const offpiste_scalar* rows, int n, int i, offpiste_given* given) {
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_CONTROLS; k++) given->control[k] = rows[k * n + i];
    OFFPISTE_UNROLL
    for (int k = 0; k < 3; k++) given->normal[k] = rows[(OFFPISTE_CONTROLS + k) * n + i];
    given->unknown = rows[(OFFPISTE_CONTROLS + 3) * n + i];
#if OFFPISTE_CODES
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_CODES; k++) given->codes[k] = rows[(OFFPISTE_CONTROLS + 4 + k) * n + i];
#endif
#if OFFPISTE_TERMS
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_TERMS; k++)
        given->terms[k] = rows[(OFFPISTE_CONTROLS + 4 + OFFPISTE_CODES + k) * n + i];
#endif
}

#ifdef OFFPISTE_FORCE_WIDTH
#define OFFPISTE_KEPT (OFFPISTE_FORCE_INPUTS + 2 * OFFPISTE_FORCE_WIDTH + 16 + 4)

OFFPISTE_FN void offpiste_keep(
    const offpiste_force_activations* a, const offpiste_force_adjoints* bar, int n, int i, offpiste_scalar* rows) {
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_FORCE_INPUTS; k++, rows += n) rows[i] = a->seen[k];
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_FORCE_WIDTH; k++, rows += n) rows[i] = a->layer[k];
    OFFPISTE_UNROLL
    for (int k = 0; k < 16 + OFFPISTE_FORCE_WIDTH; k++, rows += n) rows[i] = bar->terms[k];
    OFFPISTE_UNROLL
    for (int k = 0; k < 4; k++, rows += n) rows[i] = bar->outer[k];
}
#endif

OFFPISTE_KERNEL(
    offpiste_forward, const offpiste_params* weights, const offpiste_scalar* given, offpiste_scalar* tape, int steps,
    int n) {
    OFFPISTE_SHARED_PARAMS(params, weights)
    OFFPISTE_EACH(i, n) {
        offpiste_real state[OFFPISTE_STATE];
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_STATE; k++) state[k] = tape[k * n + i];
        for (int t = 0; t < steps; t++) {
            offpiste_given now;
            OFFPISTE_FORGET
            offpiste_read_given(given + (long long)OFFPISTE_GIVEN * t * n, n, i, &now);
            offpiste_step(params, &now, state);
            offpiste_scalar* after = tape + (long long)OFFPISTE_STATE * (t + 1) * n;
            OFFPISTE_UNROLL
            for (int k = 0; k < OFFPISTE_STATE; k++) after[k * n + i] = state[k];
        }
    }
}

/* states_bar: [steps, 10, n], of states and actuators after each step. To fill: start_bar [STATE, n], c_bar
   [CONSTANTS, n], kept [steps, KEPT, n], the rows that the gradients of the first network's weights are products of:
   inputs as it sees them, its hidden layer, adjoints of gates and layer, and of the outputs. */
OFFPISTE_KERNEL(
    offpiste_backward, const offpiste_params* weights, const offpiste_scalar* given, const offpiste_scalar* tape,
    const offpiste_scalar* states_bar, offpiste_scalar* start_bar, offpiste_scalar* constants_bar,
    offpiste_scalar* kept, int steps, int n) {
    OFFPISTE_SHARED_PARAMS(params, weights)
    OFFPISTE_EACH(i, n) {
        offpiste_real bar[OFFPISTE_STATE], c_bar[OFFPISTE_CONSTANTS];
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_STATE; k++) bar[k] = 0.0f;
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_CONSTANTS; k++) c_bar[k] = 0.0f;
        for (int t = steps - 1; t >= 0; t--) {
            offpiste_real state[OFFPISTE_STATE];
            offpiste_given now;
            offpiste_activations a;
            offpiste_adjoints step;
            OFFPISTE_FORGET
            const offpiste_scalar* before = tape + (long long)OFFPISTE_STATE * t * n;
            const offpiste_scalar* seed = states_bar + (long long)10 * t * n;
            OFFPISTE_UNROLL
            for (int k = 0; k < OFFPISTE_STATE; k++) state[k] = before[k * n + i];
            OFFPISTE_UNROLL
            for (int k = 0; k < 10; k++) bar[k] += seed[k * n + i];
            offpiste_read_given(given + (long long)OFFPISTE_GIVEN * t * n, n, i, &now);
            offpiste_step_kept(params, &now, state, &a);
            OFFPISTE_FORGET
            offpiste_step_adjoint(params, &a, bar, c_bar, &step);
#ifdef OFFPISTE_FORCE_WIDTH
            offpiste_keep(&a.force, &step.force, n, i, kept + (long long)OFFPISTE_KEPT * t * n);
#else
            (void)kept;
#endif
        }
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_STATE; k++) start_bar[k * n + i] = bar[k];
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_CONSTANTS; k++) constants_bar[k * n + i] = c_bar[k];
    }
}
