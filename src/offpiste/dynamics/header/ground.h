/* The ground under the wheels of a state, on a map of cells: bilinear slopes, codes of the nearest cell.
   slope: rise towards +x and +y of each cell, [rows, columns, 2], NaN where unknown; codes: [rows, columns, E];
   missing: the code off the map; wheels: x forward, y left of the pose point [m], front left, front right, rear left,
   rear right. grid.shift_x, _y: from the frame of the states to the centre of cell [0, 0], with the sign that adds. */
typedef struct {
    offpiste_grid grid;
    const float *slope, *codes, *missing;
    float wheels[4][2];
} offpiste_map;

OFFPISTE_FN void offpiste_look(const offpiste_map* map, const float* state, offpiste_given* given) {
    const float c = offpiste_cos(state[2]), s = offpiste_sin(state[2]);
    float normal[3] = {0.0f, 0.0f, 0.0f}, unknown = 0.0f;
    OFFPISTE_UNROLL
    for (int k = 0; k < 4; k++) {
        const float x = state[0] + c * map->wheels[k][0] - s * map->wheels[k][1];
        const float y = state[1] + s * map->wheels[k][0] + c * map->wheels[k][1];
        const offpiste_cell_place place = offpiste_cell_at(&map->grid, x, y);
        offpiste_add_normal(&map->grid, map->slope, place, normal, &unknown);
#if OFFPISTE_CODES
        offpiste_read_codes(
            map->codes, map->missing, offpiste_nearest(&map->grid, place), place.inside,
            given->codes + OFFPISTE_CODE * k);
#endif
    }
    OFFPISTE_UNROLL
    for (int k = 0; k < 3; k++) given->normal[k] = normal[k];
    given->unknown = unknown;
}
