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
        return mixed(elevation, 1, 0, between(x - x0, resolution, columns), between(y - y0, resolution, rows));
    }

    /* Properties at (x, y), bilinear. */
    Properties properties_at(double x, double y) const {
        const Between i = between(x - x0, resolution, columns), j = between(y - y0, resolution, rows);
        double found[4];
        for (int p = 0; p < 4; p++) found[p] = mixed(properties, 4, p, i, j);
        return {found[0], found[1], found[2], found[3]};
    }

    /* Number k of the `width` numbers of each node, between four nodes. */
    double mixed(const double* numbers, int64_t width, int k, Between i, Between j) const {
        const double *near = numbers + width * (j.index * columns + i.index) + k, *far = near + width * columns;
        const double first = near[0] * (1.0 - i.fraction) + near[width] * i.fraction;
        const double second = far[0] * (1.0 - i.fraction) + far[width] * i.fraction;
        return first * (1.0 - j.fraction) + second * j.fraction;
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
