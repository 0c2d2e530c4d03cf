/* Terrain and cost map under the wheels of one sample. Cells lie row by row;
   on GPUs the slope of a cell is one load, and so are four codes. */

/* shift: from the frame of the trajectories to cell [0, 0] [m]; scale: cells per metre. */
typedef struct {
    float shift_x, shift_y, scale, rows, columns;
} offpiste_grid;

/* Where a place lies on a grid, in cells, moved onto it; inside: whether it was on it. What is not a number becomes 0. */
typedef struct {
    float x, y;
    int inside;
} offpiste_cell_place;

OFFPISTE_FN offpiste_cell_place offpiste_cell_at(const offpiste_grid* grid, float px, float py) {
    const float last_x = grid->columns - 1.0f, last_y = grid->rows - 1.0f;
    offpiste_cell_place cell;
    cell.x = (px + grid->shift_x) * grid->scale;
    cell.y = (py + grid->shift_y) * grid->scale;
    cell.inside = (cell.x > -0.5f) & (cell.x < last_x + 0.5f) & (cell.y > -0.5f) & (cell.y < last_y + 0.5f);
    cell.x = cell.x > 0.0f ? (cell.x < last_x ? cell.x : last_x) : 0.0f;
    cell.y = cell.y > 0.0f ? (cell.y < last_y ? cell.y : last_y) : 0.0f;
    return cell;
}

OFFPISTE_FN int offpiste_nearest(const offpiste_grid* grid, offpiste_cell_place cell) {
    return (int)rintf(cell.y) * (int)grid->columns + (int)rintf(cell.x);
}

/* Adds a quarter of a wheel's unit normal to normal, or straight up and a quarter to unknown.
   rise: towards +x and +y, NaN where unknown. */
OFFPISTE_FN void offpiste_add_tilt(const float* rise, int inside, float* normal, float* unknown) {
    const int known = inside & (rise[0] - rise[0] == 0.0f) & (rise[1] - rise[1] == 0.0f);
    const float x = known ? rise[0] : 0.0f, y = known ? rise[1] : 0.0f;
    const float quarter = 0.25f / sqrtf(1.0f + x * x + y * y);
    normal[0] -= x * quarter;
    normal[1] -= y * quarter;
    normal[2] += quarter;
    *unknown += known ? 0.0f : 0.25f;
}

/* The same of a place on a grid. slope: rise towards +x and +y of each cell, NaN where unknown. */
OFFPISTE_FN void offpiste_add_normal(
    const offpiste_grid* grid, const float* slope, offpiste_cell_place cell, float* normal, float* unknown) {
    const float columns = grid->columns, rows = grid->rows;
    const float corner_x = columns > 2.0f ? columns - 2.0f : 0.0f, corner_y = rows > 2.0f ? rows - 2.0f : 0.0f;
    float x0 = floorf(cell.x), y0 = floorf(cell.y), s[4][2], rise[2];
    int right, up;
    const float* corner;
    x0 = x0 < corner_x ? x0 : corner_x;
    y0 = y0 < corner_y ? y0 : corner_y;
    corner = slope + 2 * ((int)y0 * (int)columns + (int)x0);
    right = columns > 1.0f ? 1 : 0; /* a map of one row or column has no cell beyond the corner */
    up = rows > 1.0f ? (int)columns : 0;
    OFFPISTE_UNROLL
    for (int n = 0; n < 4; n++) {
        const float* at = corner + 2 * ((n & 1) * right + (n >> 1) * up);
#ifdef __CUDACC__
        const float2 both = *(const float2*)at;
        s[n][0] = both.x;
        s[n][1] = both.y;
#else
        s[n][0] = at[0];
        s[n][1] = at[1];
#endif
    }
    {
        const float u = cell.x - x0, v = cell.y - y0;
        OFFPISTE_UNROLL
        for (int k = 0; k < 2; k++)
            rise[k] = (s[0][k] * (1.0f - u) + s[1][k] * u) * (1.0f - v) + (s[2][k] * (1.0f - u) + s[3][k] * u) * v;
    }
    offpiste_add_tilt(rise, cell.inside, normal, unknown);
}

#if OFFPISTE_CODES
#define OFFPISTE_CODE (OFFPISTE_CODES / 4)

/* Codes of a wheel: of its nearest cell, or the one that stands for missing features. */
OFFPISTE_FN void offpiste_read_codes(const float* codes, const float* missing, int cell, int inside, float* read) {
    const float* at = inside ? codes + OFFPISTE_CODE * cell : missing;
#if defined(__CUDACC__) && OFFPISTE_CODE % 4 == 0
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_CODE; k += 4) {
        const float4 four = ((const float4*)at)[k / 4];
        read[k] = four.x;
        read[k + 1] = four.y;
        read[k + 2] = four.z;
        read[k + 3] = four.w;
    }
#else
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_CODE; k++) read[k] = at[k];
#endif
}
#endif
