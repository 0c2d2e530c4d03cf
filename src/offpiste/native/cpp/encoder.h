/* Codes of terrain features, a cell for each lane, and back (dynamics/feature_encoder.py). Without hidden layers
   (first = 0) the features are the code, with their flag. */

namespace {
enum { CELLS = 1024 }; /* of a chunk */

struct Encoder {
    int features, first, second, size; /* first, second: multiples of four */
    int padded;                        /* columns of the last matrix, a multiple of four */
    const float *mean, *inverse_scale;
    const float* first_layer;  /* [features, flag, 1][first] */
    const float* second_layer; /* [first layer, 1][second] */
    const float* last_layer;   /* [second layer, 1][padded] */
};

/* seen: standardised features, flag, 1; then the hidden layers, each with 1 behind, then the code. */
OFFPISTE_INLINE int encoding_size(const Encoder& e) { return e.features + 2 + e.first + 1 + e.second + 1 + e.padded; }

OFFPISTE_INLINE void dense(const float* matrix, int outputs, const offpiste_real* x, int count, offpiste_real* y) {
    for (int i = 0; i < outputs; i++) y[i] = offpiste_real{};
    add_product(matrix, outputs, x, count, y);
}

/* Codes of features in the first rows of `a`; returns where they are. valid: -1 in lanes that have features. */
offpiste_real* encode(const Encoder& e, offpiste_whole valid, offpiste_real* a) {
    const offpiste_real one = all_lanes(1.0f), flag = valid ? -one : one;
    if (!e.first) {
        for (int k = 0; k < e.features; k++) a[k] = valid ? a[k] : all_lanes(e.mean[k]);
        a[e.features] = flag;
        return a;
    }
    offpiste_real *first = a + e.features + 2, *second = first + e.first + 1, *code = second + e.second + 1;
    for (int k = 0; k < e.features; k++)
        a[k] = valid ? (a[k] - e.mean[k]) * e.inverse_scale[k] : offpiste_real{};
    a[e.features] = flag;
    a[e.features + 1] = first[e.first] = second[e.second] = one;
    dense(e.first_layer, e.first, a, e.features + 2, first);
    for (int i = 0; i < e.first; i++) first[i] = offpiste_tanh(first[i]);
    dense(e.second_layer, e.second, first, e.first + 1, second);
    for (int i = 0; i < e.second; i++) second[i] = offpiste_tanh(second[i]);
    dense(e.last_layer, e.padded, second, e.second + 1, code);
    return code;
}

struct Cells {
    int count, stride;           /* numbers of a cell, of which the first are read */
    const float* features;       /* [count][stride] */
    const unsigned char* valid;  /* [count] */
};

OFFPISTE_INLINE offpiste_whole load_cells(const Encoder& e, const Cells& cells, const Block& b, offpiste_real* a) {
    offpiste_whole valid;
    load_rows(cells.features, b, cells.stride, 0, e.features, a);
    for (int i = 0; i < OFFPISTE_WIDTH; i++) valid[i] = -(cells.valid[b.window[i]] != 0);
    return valid;
}
}

OFFPISTE_ENTRY(encode)(int first, int last, const Encoder& e, const Cells& cells, float* codes) {
    Vectors a(encoding_size(e));
    for (int at = first * CELLS; at < last * CELLS && at < cells.count; at += OFFPISTE_WIDTH) {
        const Block b = block_at(at, cells.count);
        const offpiste_whole valid = load_cells(e, cells, b, a);
        store_rows(encode(e, valid, a), b, e.size, 0, e.size, codes);
    }
}

/* codes_bar: of the result. first_bar, second_bar, last_bar: of the layers, by chunk. */
OFFPISTE_ENTRY(encode_back)(
    int first, int last, const Encoder& e, const Cells& cells, const float* codes_bar, float* first_bar,
    float* second_bar, float* last_bar) {
    const int of_first = (e.features + 2) * e.first, of_second = (e.first + 1) * e.second;
    const int of_last = (e.second + 1) * e.padded, values = encoding_size(e);
    const int length = values + e.first + e.second + e.padded;
    Vectors records((size_t)KEPT * length), sums(of_first + of_second + of_last);
    for (int chunk = first; chunk < last; chunk++) {
        int slot = 0;
        for (int at = chunk * CELLS; at < (chunk + 1) * CELLS && at < cells.count; at += OFFPISTE_WIDTH) {
            const Block b = block_at(at, cells.count);
            offpiste_real* a = records + slot * length;
            const offpiste_real *inner = a + e.features + 2, *outer = inner + e.first + 1;
            offpiste_real *inner_bar = a + values, *outer_bar = inner_bar + e.first, *bar = outer_bar + e.second;
            encode(e, load_cells(e, cells, b, a), a);
            for (int k = 0; k < length - values; k++) inner_bar[k] = offpiste_real{};
            offpiste_real seed[64];
            for (int k = 0; k < e.size; k += 64) {
                const int some = e.size - k < 64 ? e.size - k : 64;
                load_rows(codes_bar, b, e.size, k, some, seed);
                for (int j = 0; j < some; j++) bar[k + j] = b.weight * seed[j];
            }
            add_transposed(e.last_layer, e.padded, bar, e.second, outer_bar);
            for (int k = 0; k < e.second; k++) outer_bar[k] *= 1.0f - outer[k] * outer[k];
            add_transposed(e.second_layer, e.second, outer_bar, e.first, inner_bar);
            for (int k = 0; k < e.first; k++) inner_bar[k] *= 1.0f - inner[k] * inner[k];
            if (++slot < KEPT && at + OFFPISTE_WIDTH < (chunk + 1) * CELLS && at + OFFPISTE_WIDTH < cells.count)
                continue;
            a = records;
            inner = a + e.features + 2, outer = inner + e.first + 1;
            inner_bar = a + values, outer_bar = inner_bar + e.first, bar = outer_bar + e.second;
            add_outer(a, e.features + 2, inner_bar, e.first, length, slot, sums);
            add_outer(inner, e.first + 1, outer_bar, e.second, length, slot, sums + of_first);
            add_outer(outer, e.second + 1, bar, e.padded, length, slot, sums + of_first + of_second);
            slot = 0;
        }
        store_sums(sums, of_first, first_bar + (long)chunk * of_first);
        store_sums(sums + of_first, of_second, second_bar + (long)chunk * of_second);
        store_sums(sums + of_first + of_second, of_last, last_bar + (long)chunk * of_last);
    }
}
