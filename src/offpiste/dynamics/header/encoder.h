/* Code of the terrain features of a cell; valid: whether there are any. See dynamics/feature_encoder.py: a network, or,
   where COMPRESSED is 0, the features as they are, the mean where there are none, then +1 or, with features, -1. */
#if COMPRESSED
typedef struct {
    float mean[FEATURES], inverse_scale[FEATURES];
    float first[FEATURES + 2][FIRST], second[FIRST + 1][SECOND], last[SECOND + 1][CODE];
} offpiste_encoder;

OFFPISTE_FN void offpiste_encode(const offpiste_encoder* e, const float* features, int valid, float* code) {
    float first[FIRST], second[SECOND];
    for (int i = 0; i < FIRST; i++) first[i] = e->first[FEATURES + 1][i] + e->first[FEATURES][i] * (valid ? -1.0f : 1.0f);
    for (int k = 0; k < FEATURES && valid; k++) {
        const float z = (features[k] - e->mean[k]) * e->inverse_scale[k];
        for (int i = 0; i < FIRST; i++) first[i] += e->first[k][i] * z;
    }
    for (int i = 0; i < SECOND; i++) second[i] = e->second[FIRST][i];
    for (int k = 0; k < FIRST; k++) {
        const float h = offpiste_tanh(first[k]);
        for (int i = 0; i < SECOND; i++) second[i] += e->second[k][i] * h;
    }
    for (int i = 0; i < CODE; i++) code[i] = e->last[SECOND][i];
    for (int k = 0; k < SECOND; k++) {
        const float h = offpiste_tanh(second[k]);
        for (int i = 0; i < CODE; i++) code[i] += e->last[k][i] * h;
    }
}
#else
typedef struct {
    float mean[FEATURES];
} offpiste_encoder;

OFFPISTE_FN void offpiste_encode(const offpiste_encoder* e, const float* features, int valid, float* code) {
    for (int k = 0; k < FEATURES; k++) code[k] = valid ? features[k] : e->mean[k];
    code[FEATURES] = valid ? -1.0f : 1.0f;
}
#endif
