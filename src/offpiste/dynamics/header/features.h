/* Features of a cell as the model reads them: as they are, the mean where there are none, then +1 or, with features, -1. */
typedef struct {
    float mean[FEATURES];
} offpiste_encoder;

OFFPISTE_FN void offpiste_encode(const offpiste_encoder* e, const float* features, int valid, float* code) {
    for (int k = 0; k < FEATURES; k++) code[k] = valid ? features[k] : e->mean[k];
    code[FEATURES] = valid ? -1.0f : 1.0f;
}
