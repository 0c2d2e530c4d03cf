/* Shape of a world's ground. */

/* Lowers the squared distances [rows][columns] of nodes at x, y to those of points [count][2] near them.

   ends: first and last + 1 column, and first and last + 1 row, of the nodes near each point [count][4]. */
OFFPISTE_ENTRY(lower_to_nearest)(
    const double* points, const int64_t* ends, int64_t count, const double* x, const double* y, int64_t columns,
    double* square) {
    for (int64_t p = 0; p < count; p++) {
        const int64_t* end = ends + 4 * p;
        for (int64_t j = end[2]; j < end[3]; j++) {
            double* row = square + j * columns;
            const double across = y[j] - points[2 * p + 1];
            for (int64_t i = end[0]; i < end[1]; i++) {
                const double along = x[i] - points[2 * p];
                row[i] = std::min(row[i], along * along + across * across);
            }
        }
    }
}

/* Lowers nodes [rows][columns] until none is more than `rise` above a neighbour (chamfer sweeps). */
OFFPISTE_ENTRY(slump)(float* elevation, int64_t rows, int64_t columns, double rise) {
    const float straight = (float)rise, diagonal = straight * std::sqrt(2.0f);
    for (bool changed = true; changed;) {
        changed = false;
        for (int side = -1; side <= 1; side += 2) {
            for (int64_t row = 0; row < rows; row++) {
                const int64_t j = side < 0 ? row : rows - 1 - row;
                const bool inside = j + side >= 0 && j + side < rows;
                float *here = elevation + j * columns, *beside = inside ? here + side * columns : nullptr;
                for (int64_t column = 0; column < columns; column++) {
                    const int64_t i = side < 0 ? column : columns - 1 - column;
                    float lowest = here[i];
                    if (i + side >= 0 && i + side < columns) lowest = std::min(lowest, here[i + side] + straight);
                    if (inside) lowest = std::min(lowest, beside[i] + straight);
                    if (inside && i > 0) lowest = std::min(lowest, beside[i - 1] + diagonal);
                    if (inside && i + 1 < columns) lowest = std::min(lowest, beside[i + 1] + diagonal);
                    if (lowest < here[i] - 1e-5f) {
                        here[i] = lowest;
                        changed = true;
                    }
                }
            }
        }
    }
}
