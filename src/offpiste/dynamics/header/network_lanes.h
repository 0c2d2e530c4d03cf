/* network.h for the lanes of a sample: lane k has unit k of the LSTM, and of the hidden layer four numbers of every
   sixteen and one of every four behind them. hidden is known to all, memory to its lane alone. */
typedef struct {
    float mean[INPUT_PLACES], inverse_scale[INPUT_PLACES], low[INPUT_PLACES], high[INPUT_PLACES];
    float gates[HIDDEN + INPUTS + 1][4 * HIDDEN];
    float inner[INPUTS + 1 + HIDDEN][WIDTH];
    float outer[WIDTH + 1][OUTPUT_PLACES];
} offpiste_NAME_network;

typedef struct {
    float outputs[OUTPUTS];
} offpiste_NAME_activations;

/* Number of the hidden layer's unit that is the lane's own number j. */
OFFPISTE_FN int offpiste_NAME_unit(int j, int lane) {
    return j < WIDTH / 16 * 4 ? j / 4 * 16 + 4 * lane + j % 4 : j / 4 * 16 + 4 * (j % 4) + lane;
}

OFFPISTE_FN void offpiste_NAME_add(float* layer, const float* row, float factor, int lane) {
    OFFPISTE_UNROLL
    for (int j = 0; j < WIDTH / 16 * 4; j += 4) offpiste_add_four(layer + j, row + 4 * j + 4 * lane, factor);
    OFFPISTE_UNROLL
    for (int j = WIDTH / 16 * 4; j < WIDTH / 4; j++) layer[j] += row[offpiste_NAME_unit(j, lane)] * factor;
}

OFFPISTE_FN void offpiste_NAME_step(
    const offpiste_NAME_network* n, const float* inputs, const float* terms, float* hidden, float* memory,
    offpiste_NAME_activations* a) {
    const int lane = OFFPISTE_LANE;
    float seen[INPUTS], layer[WIDTH / 4] = {0.0f}, cell[7] = {0.0f}, distance = 0.0f, trust;
    (void)terms;
    OFFPISTE_UNROLL
    for (int k = 0; k < INPUTS; k++) {
        const float z = (inputs[k] - n->mean[k]) * n->inverse_scale[k];
        seen[k] = offpiste_most(offpiste_least(z, n->high[k]), n->low[k]);
        distance += (z - seen[k]) * (z - seen[k]);
    }
    trust = 1.0f / (1.0f + FADE * distance);

    offpiste_add_four(cell, n->gates[HIDDEN + INPUTS] + 4 * lane, 1.0f);
    OFFPISTE_UNROLL
    for (int k = 0; k < HIDDEN; k++) offpiste_add_four(cell, n->gates[k] + 4 * lane, hidden[k]);
    OFFPISTE_UNROLL
    for (int k = 0; k < INPUTS; k++) offpiste_add_four(cell, n->gates[HIDDEN + k] + 4 * lane, seen[k]);
    cell[4] = lane < 2 ? (lane < 1 ? memory[0] : memory[1]) : (lane < 3 ? memory[2] : memory[3]);
    offpiste_cell(cell);
    OFFPISTE_UNROLL
    for (int k = 0; k < HIDDEN; k++) {
        hidden[k] = offpiste_from_lane(cell[5], k);
        memory[k] = cell[6];
    }

    offpiste_NAME_add(layer, n->inner[INPUTS], 1.0f, lane);
    OFFPISTE_UNROLL
    for (int k = 0; k < INPUTS; k++) offpiste_NAME_add(layer, n->inner[k], seen[k], lane);
    OFFPISTE_UNROLL
    for (int k = 0; k < HIDDEN; k++) offpiste_NAME_add(layer, n->inner[INPUTS + 1 + k], hidden[k], lane);
    OFFPISTE_UNROLL
    for (int k = 0; k < OUTPUTS; k++) a->outputs[k] = 0.0f;
    OFFPISTE_UNROLL
    for (int j = 0; j < WIDTH / 4; j++) {
        const float* row = n->outer[offpiste_NAME_unit(j, lane)];
        const float value = offpiste_tanh(layer[j]);
        OFFPISTE_UNROLL
        for (int k = 0; k < OUTPUTS; k++) a->outputs[k] += row[k] * value;
    }
    OFFPISTE_UNROLL
    for (int k = 0; k < OUTPUTS; k++)
        a->outputs[k] = trust * (n->outer[WIDTH][k] + offpiste_over_lanes(a->outputs[k]));
}
