/* Places on maps of cells, and normals from the slopes of cells (mapping/terrain_map.py). */

/* shift: from the frame of the rollouts to cell [0, 0] [m]; scale: cells per metre. */
struct Grid {
    float shift_x, shift_y, scale;
    int rows, columns;
};

/* Half to even, below 2^22. */
OFFPISTE_INLINE offpiste_real round_to_even(offpiste_real x) { return (x + 12582912.0f) - 12582912.0f; }
OFFPISTE_INLINE offpiste_whole whole(offpiste_real x) { return __builtin_convertvector(x, offpiste_whole); }
OFFPISTE_INLINE offpiste_real at_most(offpiste_real x, offpiste_real y) { return x < y ? x : y; }

/* Where places lie, in cells, moved onto the grid; inside: -1 in lanes that were on it. What is not a number becomes 0. */
struct Place {
    offpiste_real x, y;
    offpiste_whole inside;
};

OFFPISTE_INLINE Place on_grid(offpiste_real x, offpiste_real y, offpiste_real last_x, offpiste_real last_y) {
    Place p;
    p.inside = (x > -0.5f) & (x < last_x + 0.5f) & (y > -0.5f) & (y < last_y + 0.5f);
    p.x = x > 0.0f ? at_most(x, last_x) : offpiste_real{};
    p.y = y > 0.0f ? at_most(y, last_y) : offpiste_real{};
    return p;
}

OFFPISTE_INLINE Place place_on(const Grid& g, offpiste_real px, offpiste_real py) {
    const offpiste_real x = (px + g.shift_x) * g.scale, y = (py + g.shift_y) * g.scale;
    return on_grid(x, y, all_lanes(g.columns - 1.0f), all_lanes(g.rows - 1.0f));
}

OFFPISTE_INLINE offpiste_whole nearest(const Place& p, int columns) {
    return whole(round_to_even(p.y)) * columns + whole(round_to_even(p.x));
}

/* Lower left one of the four cells around a place; u, v: from there, in cells. */
OFFPISTE_INLINE void corner_of(
    const Place& p, offpiste_real last_x, offpiste_real last_y, offpiste_real* x0, offpiste_real* y0) {
    *x0 = at_most(offpiste_floor(p.x), offpiste_maximum(last_x - 1.0f, 0.0f));
    *y0 = at_most(offpiste_floor(p.y), offpiste_maximum(last_y - 1.0f, 0.0f));
}

struct Ground {
    offpiste_real normal[3], unknown; /* mean of the wheels' unit normals, straight up where unknown; share of these */
};

/* Adds a wheel: slopes of four cells, the corner, its right neighbour, and both above, x and y of each. */
OFFPISTE_INLINE void add_wheel(
    Ground& g, const offpiste_real* slope, offpiste_real u, offpiste_real v, offpiste_whole inside) {
    offpiste_real rise[2];
    for (int k = 0; k < 2; k++)
        rise[k] = (slope[k] * (1.0f - u) + slope[2 + k] * u) * (1.0f - v) +
                  (slope[4 + k] * (1.0f - u) + slope[6 + k] * u) * v;
    const offpiste_whole known = inside & (rise[0] - rise[0] == 0.0f) & (rise[1] - rise[1] == 0.0f);
    const offpiste_real x = known ? rise[0] : offpiste_real{}, y = known ? rise[1] : offpiste_real{};
    const offpiste_real quarter = 0.25f / square_root(1.0f + x * x + y * y);
    g.normal[0] -= x * quarter;
    g.normal[1] -= y * quarter;
    g.normal[2] += quarter;
    g.unknown += known ? offpiste_real{} : all_lanes(0.25f);
}

OFFPISTE_INLINE void store_ground(const Ground& g, offpiste_real* w) {
    for (int k = 0; k < 3; k++) w[OFFPISTE_NORMAL + k] = g.normal[k];
    w[OFFPISTE_UNKNOWN] = g.unknown;
}
