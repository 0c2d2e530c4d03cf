/* Interpolation of a world's grids at single places, clamped at the border. */

namespace vehicle {

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

/* Properties of the ground at a place (logs/ground_truth.py). */
struct Properties {
    double friction, cornering_stiffness, rolling_resistance, sinkage_drag;
};

/* Nodes of the ground, `resolution` apart, the first at (x0, y0). */
struct Ground {
    const double *elevation, *properties; /* [rows][columns] [m], [rows][columns][4] */
    int64_t rows, columns;
    double x0, y0, resolution;

    /* Elevation at (x, y), bilinear [m]. */
    double height(double x, double y) const {
        const Between i = between(x - x0, resolution, columns), j = between(y - y0, resolution, rows);
        const double *near = elevation + j.index * columns + i.index, *far = near + columns;
        const double first = near[0] * (1.0 - i.fraction) + near[1] * i.fraction;
        const double second = far[0] * (1.0 - i.fraction) + far[1] * i.fraction;
        return first * (1.0 - j.fraction) + second * j.fraction;
    }

    /* Properties at (x, y), bilinear. */
    Properties properties_at(double x, double y) const {
        const Between i = between(x - x0, resolution, columns), j = between(y - y0, resolution, rows);
        const double *near = properties + 4 * (j.index * columns + i.index), *far = near + 4 * columns;
        double found[4];
        for (int p = 0; p < 4; p++) {
            const double first = near[p] * (1.0 - i.fraction) + near[p + 4] * i.fraction;
            const double second = far[p] * (1.0 - i.fraction) + far[p + 4] * i.fraction;
            found[p] = first * (1.0 - j.fraction) + second * j.fraction;
        }
        return {found[0], found[1], found[2], found[3]};
    }
};

/* Heights and properties at places x, y [count][2]; for tests. */
OFFPISTE_ENTRY(read_ground)(
    const double* elevation, const double* properties, int64_t rows, int64_t columns, double x0, double y0,
    double resolution, const double* places, int64_t count, double* heights, Properties* found) {
    const Ground ground = {elevation, properties, rows, columns, x0, y0, resolution};
    for (int64_t k = 0; k < count; k++) {
        const double x = places[2 * k], y = places[2 * k + 1];
        heights[k] = ground.height(x, y);
        found[k] = ground.properties_at(x, y);
    }
}

}
