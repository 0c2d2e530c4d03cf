/* Responses of an image to derivatives of a Gaussian in every direction, as sums of separable filters. */

namespace {

constexpr int FILTER_LINES = 4, FILTER_PRODUCTS = 7, MOST_FILTER_TAPS = 31;
/* Horizontal and vertical lines whose products are combined: `PRODUCTS` of filter_responses.py. */
constexpr int ACROSS[FILTER_PRODUCTS] = {1, 0, 2, 1, 0, 0, 3}, DOWN[FILTER_PRODUCTS] = {0, 1, 0, 1, 2, 0, 3};

/* Filters a row with each of the lines [4][size]; from[t] is the row from tap t on. */
inline void filter_across(
    const float* const* from, const float* lines, int64_t size, int64_t number, float* across) {
    for (int64_t i = 0; i < number; i += OFFPISTE_WIDTH) {
        offpiste_real sums[FILTER_LINES] = {};
        for (int64_t t = 0; t < size; t++) {
            const offpiste_real x = load(from[t] + i);
            for (int k = 0; k < FILTER_LINES; k++) sums[k] += x * lines[k * size + t];
        }
        for (int k = 0; k < FILTER_LINES; k++) store(across + k * number + i, sums[k]);
    }
}

/* Adds the magnitudes of all responses of a row to `sums` [filters][number]; rows[t] are the filtered rows [4][number]
   at tap t. */
inline void add_magnitudes(
    const float* const* rows, const float* lines, int64_t size, const float* weights, int64_t filters, int64_t number,
    float* sums) {
    for (int64_t i = 0; i < number; i += OFFPISTE_WIDTH) {
        offpiste_real products[FILTER_PRODUCTS] = {};
        for (int64_t t = 0; t < size; t++) {
            offpiste_real x[FILTER_LINES];
            for (int k = 0; k < FILTER_LINES; k++) x[k] = load(rows[t] + k * number + i);
            for (int p = 0; p < FILTER_PRODUCTS; p++) products[p] += x[ACROSS[p]] * lines[DOWN[p] * size + t];
        }
        for (int64_t k = 0; k < filters; k++) {
            offpiste_real response = {};
            for (int p = 0; p < FILTER_PRODUCTS; p++) response += products[p] * weights[FILTER_PRODUCTS * k + p];
            *(offpiste_stored*)(sums + k * number + i) += offpiste_maximum(response, -response);
        }
    }
}

}

/* Writes patch means [filters][rows][columns] of the magnitudes of responses at every `step` (1 or 2) pixels.

   image: with a margin that the lines [4][size] reach; its rows have `stride` pixels.
   number: responses in a row, whole vectors.
   work: [size * 4 * number + filters * number + stride]. */
OFFPISTE_ENTRY(put_responses)(
    const float* image, int64_t stride, int64_t step, const float* lines, int64_t size, const float* weights,
    int64_t filters, int64_t patch, int64_t rows, int64_t columns, int64_t number, float* work, float* means) {
    const int64_t filtered = FILTER_LINES * number;
    float *across = work, *sums = across + size * filtered, *even = sums + filters * number,
          *odd = even + stride / 2;
    const float* from[MOST_FILTER_TAPS];
    for (int64_t row = 0, ready = 0; row < rows; row++) {
        std::fill(sums, sums + filters * number, 0.0f);
        for (int64_t first = step * row * patch; first < step * (row + 1) * patch; first += step) {
            for (; ready < first + size; ready++) {
                const float* pixels = image + ready * stride;
                if (step == 2) {
                    for (int64_t i = 0; i < stride / 2; i++) even[i] = pixels[2 * i], odd[i] = pixels[2 * i + 1];
                }
                for (int64_t t = 0; t < size; t++)
                    from[t] = step == 1 ? pixels + t : (t % 2 ? odd : even) + t / 2;
                filter_across(from, lines, size, number, across + ready % size * filtered);
            }
            for (int64_t t = 0; t < size; t++) from[t] = across + (first + t) % size * filtered;
            add_magnitudes(from, lines, size, weights, filters, number, sums);
        }
        for (int64_t k = 0; k < filters; k++)
            for (int64_t column = 0; column < columns; column++) {
                const float* patch_sums = sums + k * number + column * patch;
                float total = 0.0f;
                for (int64_t i = 0; i < patch; i++) total += patch_sums[i];
                means[(k * rows + row) * columns + column] = total / (float)(patch * patch);
            }
    }
}
