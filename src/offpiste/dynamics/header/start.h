/* The recurrent state of network NAME from the recent past: an LSTM of SPAN units over its inputs at past rows, then
   BREADTH units; see dynamics/lstm.py. Matrices lie input by input, biases last. */
typedef struct {
    offpiste_scalar from_inputs[INPUTS + 1][4 * SPAN], from_hidden[SPAN][4 * SPAN];
    offpiste_scalar first[SPAN + 1][BREADTH], last[BREADTH + 1][2 * HIDDEN];
} offpiste_NAME_start_network;

typedef struct {
    offpiste_real hidden[SPAN], memory[SPAN];
} offpiste_NAME_past;

/* One row of the past. */
OFFPISTE_FN void offpiste_NAME_remember(
    const offpiste_NAME_network* n, const offpiste_NAME_start_network* s, const offpiste_real* inputs,
    offpiste_NAME_past* past) {
    offpiste_real gates[4 * SPAN];
    for (int i = 0; i < 4 * SPAN; i++) gates[i] = s->from_inputs[INPUTS][i] + 0.0f * inputs[0];
    for (int k = 0; k < INPUTS; k++) {
        offpiste_real z = (inputs[k] - n->mean[k]) * n->inverse_scale[k];
        z = z < n->high[k] ? z : n->high[k];
        z = z > n->low[k] ? z : n->low[k];
        for (int i = 0; i < 4 * SPAN; i++) gates[i] += s->from_inputs[k][i] * z;
    }
    for (int k = 0; k < SPAN; k++)
        for (int i = 0; i < 4 * SPAN; i++) gates[i] += s->from_hidden[k][i] * past->hidden[k];
    for (int i = 0; i < SPAN; i++) {
        offpiste_real cell[7];
        for (int k = 0; k < 4; k++) cell[k] = gates[k * SPAN + i];
        cell[4] = past->memory[i];
        offpiste_cell(cell);
        past->hidden[i] = cell[5];
        past->memory[i] = cell[6];
    }
}

/* The network's own hidden units and cells. */
OFFPISTE_FN void offpiste_NAME_begin(
    const offpiste_NAME_start_network* s, const offpiste_NAME_past* past, offpiste_real* hidden,
    offpiste_real* memory) {
    offpiste_real layer[BREADTH], last[2 * HIDDEN];
    for (int i = 0; i < BREADTH; i++) {
        layer[i] = s->first[SPAN][i] + s->first[0][i] * past->hidden[0];
        for (int k = 1; k < SPAN; k++) layer[i] += s->first[k][i] * past->hidden[k];
        layer[i] = offpiste_tanh(layer[i]);
    }
    for (int i = 0; i < 2 * HIDDEN; i++) {
        last[i] = s->last[BREADTH][i] + s->last[0][i] * layer[0];
        for (int k = 1; k < BREADTH; k++) last[i] += s->last[k][i] * layer[k];
    }
    for (int i = 0; i < HIDDEN; i++) {
        hidden[i] = offpiste_tanh(last[i]);
        memory[i] = last[HIDDEN + i];
    }
}
