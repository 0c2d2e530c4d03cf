/* Motion compensation of scans. */

/* Transforms points [count][3] into the world, each by the matrix [4][4] of its time. */
OFFPISTE_ENTRY(put_in_world)(
    const double* points, const int64_t* which, const double* world_from_lidar, int64_t count, double* world) {
    for (int64_t i = 0; i < count; i++) {
        const double *matrix = world_from_lidar + 16 * which[i], *point = points + 3 * i;
        for (int axis = 0; axis < 3; axis++) {
            const double* row = matrix + 4 * axis;
            world[3 * i + axis] = row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3];
        }
    }
}
