/* One network: NAME, INPUTS, WIDTH, OUTPUTS, TERMS stand for its name and its sizes. HIDDEN units of an LSTM and a
   hidden layer; see dynamics/lstm.py. Matrices lie input by input: gates on (hidden before, inputs, 1), inner on
   (inputs, 1, hidden after), outer on (hidden layer, 1). Rows are multiples of 16 bytes long: INPUT_PLACES and
   OUTPUT_PLACES are sizes with that room. */
typedef struct {
    offpiste_scalar mean[INPUT_PLACES], inverse_scale[INPUT_PLACES], low[INPUT_PLACES], high[INPUT_PLACES];
    offpiste_scalar gates[HIDDEN + INPUTS + 1][4 * HIDDEN];
    offpiste_scalar inner[INPUTS + 1 + HIDDEN][WIDTH];
    offpiste_scalar outer[WIDTH + 1][OUTPUT_PLACES];
} offpiste_NAME_network;

/* What one step leaves for the adjoint: standardised inputs within their ranges and their square distance from these,
   the cell's workspace, the hidden layer, and the factor of the outputs. */
typedef struct {
    offpiste_real seen[INPUTS], beyond[INPUTS], cell[HIDDEN][7], layer[WIDTH], trust, outputs[OUTPUTS];
} offpiste_NAME_activations;

/* hidden, memory: before the step, and then after it. terms: added to gates and layer from elsewhere, TERMS numbers. */
OFFPISTE_FN void offpiste_NAME_step(
    const offpiste_NAME_network* n, const offpiste_real* inputs, const offpiste_real* terms, offpiste_real* hidden,
    offpiste_real* memory, offpiste_NAME_activations* a) {
    offpiste_real gates[4 * HIDDEN], distance = {0.0f};
    OFFPISTE_UNROLL
    for (int k = 0; k < INPUTS; k++) {
        const offpiste_real z = (inputs[k] - n->mean[k]) * n->inverse_scale[k];
        const offpiste_real above = z < n->high[k] ? z : n->high[k];
        a->seen[k] = above > n->low[k] ? above : n->low[k];
        a->beyond[k] = z - a->seen[k];
        distance += a->beyond[k] * a->beyond[k];
    }
    a->trust = 1.0f / (1.0f + FADE * distance);

    OFFPISTE_UNROLL
    for (int i = 0; i < 4 * HIDDEN; i++) gates[i] = n->gates[HIDDEN + INPUTS][i] + n->gates[0][i] * hidden[0];
    OFFPISTE_UNROLL
    for (int k = 1; k < HIDDEN; k++)
        OFFPISTE_UNROLL
        for (int i = 0; i < 4 * HIDDEN; i++) gates[i] += n->gates[k][i] * hidden[k];
    OFFPISTE_UNROLL
    for (int k = 0; k < INPUTS; k++)
        OFFPISTE_UNROLL
        for (int i = 0; i < 4 * HIDDEN; i++) gates[i] += n->gates[HIDDEN + k][i] * a->seen[k];
    OFFPISTE_UNROLL
    for (int i = 0; i < 4 * HIDDEN && TERMS; i++) gates[i] += terms[i];
    OFFPISTE_UNROLL
    for (int i = 0; i < HIDDEN; i++) {
        offpiste_real* cell = a->cell[i];
        OFFPISTE_UNROLL
        for (int k = 0; k < 4; k++) cell[k] = gates[k * HIDDEN + i];
        cell[4] = memory[i];
        offpiste_cell(cell);
        hidden[i] = cell[5];
        memory[i] = cell[6];
    }

    OFFPISTE_UNROLL
    for (int i = 0; i < WIDTH; i++) a->layer[i] = n->inner[INPUTS][i] + n->inner[0][i] * a->seen[0];
    OFFPISTE_UNROLL
    for (int k = 1; k < INPUTS; k++)
        OFFPISTE_UNROLL
        for (int i = 0; i < WIDTH; i++) a->layer[i] += n->inner[k][i] * a->seen[k];
    OFFPISTE_UNROLL
    for (int k = 0; k < HIDDEN; k++)
        OFFPISTE_UNROLL
        for (int i = 0; i < WIDTH; i++) a->layer[i] += n->inner[INPUTS + 1 + k][i] * hidden[k];
    OFFPISTE_UNROLL
    for (int i = 0; i < WIDTH && TERMS; i++) a->layer[i] += terms[4 * HIDDEN + i];
    OFFPISTE_UNROLL
    for (int i = 0; i < WIDTH; i++) a->layer[i] = offpiste_tanh(a->layer[i]);
    OFFPISTE_UNROLL
    for (int i = 0; i < OUTPUTS; i++) a->outputs[i] = n->outer[WIDTH][i] + n->outer[0][i] * a->layer[0];
    OFFPISTE_UNROLL
    for (int k = 1; k < WIDTH; k++)
        OFFPISTE_UNROLL
        for (int i = 0; i < OUTPUTS; i++) a->outputs[i] += n->outer[k][i] * a->layer[k];
    OFFPISTE_UNROLL
    for (int i = 0; i < OUTPUTS; i++) a->outputs[i] *= a->trust;
}
