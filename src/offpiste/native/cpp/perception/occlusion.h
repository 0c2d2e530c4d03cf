/* Directions in which a z-buffer holds nearer points around a place. */

namespace {
typedef double EightDepths __attribute__((vector_size(64), aligned(8)));
typedef int64_t EightBits __attribute__((vector_size(64), aligned(8)));
}

/* Writes for each of `count` points the bits of all cells in its window that are nearer than its limit.

   The window [rows][columns] has the bits of each cell and begins at cell `first` of `nearest`, whose rows have `stride`
   cells. Its columns are a multiple of 8. */
OFFPISTE_ENTRY(find_nearer)(
    const double* nearest, int64_t stride, const int64_t* first, const double* limit, int64_t count,
    const int64_t* window, int64_t rows, int64_t columns, int64_t* found) {
    for (int64_t i = 0; i < count; i++) {
        EightBits bits = {};
        for (int64_t y = 0; y < rows; y++)
            for (int64_t x = 0; x < columns; x += 8) {
                const EightDepths* cells = (const EightDepths*)(nearest + first[i] + y * stride + x);
                bits |= (*cells < limit[i]) & *(const EightBits*)(window + y * columns + x);
            }
        found[i] = 0;
        for (int k = 0; k < 8; k++) found[i] |= bits[k];
    }
}
