/* Adjoints of one network's step. terms: of gates, then hidden layer: from these rows and those of the activations
   come the weights' gradients. outer: of the outputs before their factor. */
typedef struct {
    offpiste_real inputs[INPUTS], terms[4 * HIDDEN + WIDTH], outer[OUTPUTS];
} offpiste_NAME_adjoints;

/* hidden_bar, memory_bar: of the state after the step, and then before it. outputs_bar: of the outputs. */
OFFPISTE_FN void offpiste_NAME_adjoint(
    const offpiste_NAME_network* n, const offpiste_NAME_activations* a, const offpiste_real* outputs_bar,
    offpiste_real* hidden_bar, offpiste_real* memory_bar, offpiste_NAME_adjoints* bar) {
    offpiste_real trust_bar = {0.0f}; /* of the trust's logarithm */
    offpiste_real* gates = bar->terms;
    offpiste_real* layer = bar->terms + 4 * HIDDEN;
    OFFPISTE_UNROLL
    for (int i = 0; i < OUTPUTS; i++) {
        trust_bar += outputs_bar[i] * a->outputs[i];
        bar->outer[i] = outputs_bar[i] * a->trust;
    }
    OFFPISTE_UNROLL
    for (int k = 0; k < WIDTH; k++) {
        offpiste_real sum = n->outer[k][0] * bar->outer[0];
        OFFPISTE_UNROLL
        for (int i = 1; i < OUTPUTS; i++) sum += n->outer[k][i] * bar->outer[i];
        layer[k] = sum * (1.0f - a->layer[k] * a->layer[k]);
    }
    OFFPISTE_UNROLL
    for (int i = 0; i < HIDDEN; i++) {
        offpiste_real cell_bar[7] = {0.0f};
        cell_bar[5] = hidden_bar[i];
        OFFPISTE_UNROLL
        for (int k = 0; k < WIDTH; k++) cell_bar[5] += n->inner[INPUTS + 1 + i][k] * layer[k];
        cell_bar[6] = memory_bar[i];
        offpiste_cell_adjoint(a->cell[i], cell_bar);
        OFFPISTE_UNROLL
        for (int k = 0; k < 4; k++) gates[k * HIDDEN + i] = cell_bar[k];
        memory_bar[i] = cell_bar[4];
    }
    OFFPISTE_UNROLL
    for (int k = 0; k < HIDDEN; k++) {
        hidden_bar[k] = n->gates[k][0] * gates[0];
        OFFPISTE_UNROLL
        for (int i = 1; i < 4 * HIDDEN; i++) hidden_bar[k] += n->gates[k][i] * gates[i];
    }
    OFFPISTE_UNROLL
    for (int k = 0; k < INPUTS; k++) {
        offpiste_real sum = n->gates[HIDDEN + k][0] * gates[0];
        OFFPISTE_UNROLL
        for (int i = 1; i < 4 * HIDDEN; i++) sum += n->gates[HIDDEN + k][i] * gates[i];
        OFFPISTE_UNROLL
        for (int i = 0; i < WIDTH; i++) sum += n->inner[k][i] * layer[i];
        sum = a->beyond[k] == 0.0f ? sum : 0.0f;
        bar->inputs[k] = (sum - 2.0f * FADE * a->beyond[k] * a->trust * trust_bar) * n->inverse_scale[k];
    }
}
