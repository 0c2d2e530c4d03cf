/* Interpolation of a world's grids at single places, clamped at the border. */

namespace {

/* Index of the first of two nodes along an axis, and the second one's weight. */
struct Between {
    int64_t index;
    double fraction;
};

/* Place of a distance from the first of at least two nodes, clamped; NaN reads the border. */
inline Between between(double distance, double resolution, int64_t nodes) {
    const double position = distance / resolution, last = (double)(nodes - 1);
    const double inside = position > 0.0 ? (position < last ? position : last) : 0.0;
    const int64_t index = std::min((int64_t)inside, nodes - 2);
    return {index, inside - (double)index};
}

/* Elevation [m] at (x, y), bilinear, from nodes [rows][columns] `resolution` apart, the first at (x0, y0). */
inline double height(
    const double* elevation, int64_t rows, int64_t columns, double x0, double y0, double resolution, double x, double y) {
    const Between i = between(x - x0, resolution, columns), j = between(y - y0, resolution, rows);
    const double *near = elevation + j.index * columns + i.index, *far = near + columns;
    const double first = near[0] * (1.0 - i.fraction) + near[1] * i.fraction;
    const double second = far[0] * (1.0 - i.fraction) + far[1] * i.fraction;
    return first * (1.0 - j.fraction) + second * j.fraction;
}

/* Writes the properties [rows][columns][4] of the ground at (x, y), bilinear, to `out` [4]. */
inline void properties_at(
    const double* properties, int64_t rows, int64_t columns, double x0, double y0, double resolution, double x, double y,
    double* out) {
    const Between i = between(x - x0, resolution, columns), j = between(y - y0, resolution, rows);
    const double *near = properties + 4 * (j.index * columns + i.index), *far = near + 4 * columns;
    for (int p = 0; p < 4; p++) {
        const double first = near[p] * (1.0 - i.fraction) + near[p + 4] * i.fraction;
        const double second = far[p] * (1.0 - i.fraction) + far[p + 4] * i.fraction;
        out[p] = first * (1.0 - j.fraction) + second * j.fraction;
    }
}

}

/* Heights and properties at many places x, y [count][2], for the tests of the functions above. */
OFFPISTE_ENTRY(read_ground)(
    const double* elevation, const double* properties, int64_t rows, int64_t columns, double x0, double y0,
    double resolution, const double* places, int64_t count, double* heights, double* found) {
    for (int64_t k = 0; k < count; k++) {
        const double x = places[2 * k], y = places[2 * k + 1];
        heights[k] = height(elevation, rows, columns, x0, y0, resolution, x, y);
        properties_at(properties, rows, columns, x0, y0, resolution, x, y, found + 4 * k);
    }
}
