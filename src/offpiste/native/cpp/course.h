/* Distance of cells to the nearest point of a path, and that point's values (planning/course.py). Far from the path the
   cells of a block share their nearest point. */

namespace {
struct Path {
    const double* points; /* [count][2] */
    const float* values;  /* [count][width] */
    const double *x, *y;  /* of columns and rows of cells, evenly spaced [m] */
    int count, width, columns, rows, block, near, stride;
    double slack, resolution; /* largest length of a stride [m] */
};

OFFPISTE_INLINE double square_distance(const Path& p, int k, double x, double y) {
    const double dx = p.points[2 * k] - x, dy = p.points[2 * k + 1] - y;
    return dx * dx + dy * dy;
}

/* The nearest of every stride-th point. */
OFFPISTE_INLINE int nearest_point(const Path& p, double x, double y, int begin, int end, int stride, double* least) {
    int best = begin;
    *least = INFINITY;
    for (int k = begin; k < end; k += stride) {
        const double squared = square_distance(p, k, x, y);
        if (squared < *least) best = k, *least = squared;
    }
    return best;
}
}

OFFPISTE_ENTRY(fill_course)(int first, int last, const Path& p, float* result) {
    const double half = (p.block - 1) / 2.0 * p.resolution;
    for (int row = first; row < last; row++)
        for (int column = 0; column < p.columns; column += p.block) {
            const double px = p.x[column] + half, py = p.y[row * p.block] + half;
            double squared;
            const int coarse = nearest_point(p, px, py, 0, p.count, p.stride, &squared);
            const double distance = sqrt(squared);
            const bool near = distance < p.near * p.block * p.resolution;
            /* A cell lies up to sqrt(2) half from the middle, and its nearest point up to as far again. */
            const double reach = distance + p.slack + (near ? 3 * half : 0.0);
            int begin = coarse, end = coarse + 1; /* at least one point, even where distances are NaN */
            for (int k = 0; k < p.count; k += p.stride)
                if (square_distance(p, k, px, py) <= reach * reach) {
                    begin = k < begin ? k : begin;
                    end = k + p.stride > end ? k + p.stride : end;
                }
            end = end < p.count ? end : p.count;
            int best = nearest_point(p, px, py, begin, end, 1, &squared);
            for (int j = row * p.block; j < (row + 1) * p.block && j < p.rows; j++)
                for (int i = column; i < column + p.block && i < p.columns; i++) {
                    if (near) best = nearest_point(p, p.x[i], p.y[j], begin, end, 1, &squared);
                    else squared = square_distance(p, best, p.x[i], p.y[j]);
                    float* cell = result + ((long)j * p.columns + i) * (1 + p.width);
                    cell[0] = (float)sqrt(squared);
                    for (int v = 0; v < p.width; v++) cell[1 + v] = p.values[best * p.width + v];
                }
        }
}
