/* Products of small matrices of weights with vectors of lanes. Matrices lie input by input: [inputs][outputs]. */

template <int R>
OFFPISTE_INLINE void add_columns(
    const float* matrix, int stride, const offpiste_real* x, int count, offpiste_real* y) {
    offpiste_real sums[R];
    for (int r = 0; r < R; r++) sums[r] = y[r];
    for (int k = 0; k < count; k++, matrix += stride) {
        const offpiste_real factor = x[k];
        for (int r = 0; r < R; r++) sums[r] += matrix[r] * factor;
    }
    for (int r = 0; r < R; r++) y[r] = sums[r];
}

/* y += matrix^T x; outputs: a multiple of four. */
static __attribute__((noinline, unused)) void add_product(
    const float* matrix, int outputs, const offpiste_real* x, int count, offpiste_real* y) {
    int i = 0;
    while (i < outputs) {
        const int left = outputs - i;
        if (left == 12 || left == 20 || left >= 24) {
            add_columns<12>(matrix + i, outputs, x, count, y + i);
            i += 12;
        } else if (left >= 8) {
            add_columns<8>(matrix + i, outputs, x, count, y + i);
            i += 8;
        } else {
            add_columns<4>(matrix + i, outputs, x, count, y + i);
            i += 4;
        }
    }
}

template <int R>
OFFPISTE_INLINE void add_rows(
    const float* matrix, int outputs, const offpiste_real* y_bar, offpiste_real* x_bar) {
    offpiste_real sums[R];
    for (int r = 0; r < R; r++) sums[r] = x_bar[r];
    for (int i = 0; i < outputs; i++) {
        const offpiste_real factor = y_bar[i];
        for (int r = 0; r < R; r++) sums[r] += matrix[r * outputs + i] * factor;
    }
    for (int r = 0; r < R; r++) x_bar[r] = sums[r];
}

/* x_bar += matrix y_bar, the adjoint of `add_product`. */
static __attribute__((noinline, unused)) void add_transposed(
    const float* matrix, int outputs, const offpiste_real* y_bar, int count, offpiste_real* x_bar) {
    int k = 0;
    for (; k + 8 <= count; k += 8) add_rows<8>(matrix + k * outputs, outputs, y_bar, x_bar + k);
    for (; k + 4 <= count; k += 4) add_rows<4>(matrix + k * outputs, outputs, y_bar, x_bar + k);
    for (; k < count; k++) add_rows<1>(matrix + k * outputs, outputs, y_bar, x_bar + k);
}

template <int R>
OFFPISTE_INLINE void add_outer_columns(
    const offpiste_real* x, const offpiste_real* y_bar, int stride, int steps, offpiste_real* sums) {
    offpiste_real own[R];
    for (int r = 0; r < R; r++) own[r] = sums[r];
    for (int s = 0; s < steps; s++, x += stride, y_bar += stride)
        for (int r = 0; r < R; r++) own[r] += *x * y_bar[r];
    for (int r = 0; r < R; r++) sums[r] = own[r];
}

/* sums += x y_bar^T, added up over records that lie `stride` apart; outputs: a multiple of four. */
static __attribute__((noinline, unused)) void add_outer(
    const offpiste_real* x, int count, const offpiste_real* y_bar, int outputs, int stride, int steps,
    offpiste_real* sums) {
    for (int k = 0; k < count; k++, sums += outputs) {
        int i = 0;
        for (; i + 8 <= outputs; i += 8) add_outer_columns<8>(x + k, y_bar + i, stride, steps, sums + i);
        for (; i < outputs; i += 4) add_outer_columns<4>(x + k, y_bar + i, stride, steps, sums + i);
    }
}
