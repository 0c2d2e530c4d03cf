/* Reads a parity file: inputs, and the outputs that offpiste computed from them. All numbers are little-endian; int32
   sizes first, then float32:
     "opar", version, rows, columns, features, drives, past rows, steps, controls
     16 characters: digest of the model (OFFPISTE_DIGEST)
     x, y of the centre of cell [0, 0], cell size [m]; wheels [4, 2]
     slope [rows, columns, 2]; features [rows, columns, F], NaN where missing
     past states [drives, past, 10], past controls [drives, past, U], start [drives, 10], controls [drives, steps, U]
     expected states [drives, steps, 10]
     CRC-32 of all bytes before it, uint32
   A state is px, py, yaw, vx, vy, yaw rate, brake, steer, steer rate, engine.
   Include offpiste.h before. */
#ifndef OFFPISTE_PARITY_H
#define OFFPISTE_PARITY_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int rows, columns, features, drives, past, steps, controls;
    float x, y, resolution, wheels[4][2];
    float *slope, *cells, *past_states, *past_controls, *start, *control, *expected;
    unsigned char* content;
} offpiste_parity;

static uint32_t offpiste_crc32(const unsigned char* bytes, size_t count) {
    uint32_t crc = 0xffffffffu;
    size_t i;
    int bit;
    for (i = 0; i < count; i++) {
        crc ^= bytes[i];
        for (bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xedb88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static void offpiste_refuse_parity(const char* path, const char* why) {
    fprintf(stderr, "%s: %s\n", path, why);
    exit(1);
}

/* Reads a parity file, or says what is wrong with it and exits with 1. */
static offpiste_parity offpiste_read_parity(const char* path) {
    const size_t head = 52; /* bytes before the numbers */
    offpiste_parity p;
    int32_t sizes[8];
    uint32_t crc;
    size_t cells, drives, rows, count;
    float* next;
    long length = -1;
    FILE* file = fopen(path, "rb");
    if (file && !fseek(file, 0, SEEK_END)) length = ftell(file);
    if (length < (long)head + 4) offpiste_refuse_parity(path, "no parity file of version 3");
    count = (size_t)length - 4;
    p.content = (unsigned char*)malloc((size_t)length);
    rewind(file);
    if (!p.content || fread(p.content, 1, (size_t)length, file) != (size_t)length)
        offpiste_refuse_parity(path, "cannot be read");
    fclose(file);
    memcpy(sizes, p.content + 4, sizeof sizes);
    if (memcmp(p.content, "opar", 4) || sizes[0] != 3) offpiste_refuse_parity(path, "no parity file of version 3");
    memcpy(&crc, p.content + count, 4);
    if (crc != offpiste_crc32(p.content, count)) offpiste_refuse_parity(path, "is damaged or cut short; export it again");
    p.rows = sizes[1], p.columns = sizes[2], p.features = sizes[3], p.drives = sizes[4];
    p.past = sizes[5], p.steps = sizes[6], p.controls = sizes[7];
    if (memcmp(p.content + 36, OFFPISTE_DIGEST, 16) || p.controls != OFFPISTE_CONTROLS ||
        p.features != OFFPISTE_FEATURES || p.past != OFFPISTE_PAST)
        offpiste_refuse_parity(path, "belongs to another model than offpiste.h");
    cells = (size_t)p.rows * p.columns, drives = (size_t)p.drives, rows = drives * p.steps;
    next = (float*)(void*)(p.content + head);
    p.x = next[0], p.y = next[1], p.resolution = next[2];
    memcpy(p.wheels, next + 3, sizeof p.wheels);
    p.slope = next + 11;
    p.cells = p.slope + 2 * cells;
    p.past_states = p.cells + p.features * cells;
    p.past_controls = p.past_states + drives * p.past * 10;
    p.start = p.past_controls + drives * p.past * p.controls;
    p.control = p.start + drives * 10;
    p.expected = p.control + rows * p.controls;
    if ((size_t)(p.expected - next + rows * 10) * sizeof(float) != count - head)
        offpiste_refuse_parity(path, "has another length than its sizes say");
    return p;
}

/* Codes of the cells of a map, and of a cell without features, [rows * columns + 1, E]. */
static float* offpiste_code_cells(const offpiste_parity* p) {
    const int cells = p->rows * p->columns;
    float* codes = (float*)malloc(sizeof(float) * (OFFPISTE_CODES / 4 + 1) * (cells + 1));
    int cell;
    if (!codes) exit(1);
#if OFFPISTE_CODES
    for (cell = 0; cell <= cells; cell++) {
        const float* features = p->cells + (size_t)p->features * (cell < cells ? cell : 0);
        int valid = cell < cells, k;
        for (k = 0; k < p->features; k++) valid &= features[k] == features[k];
        offpiste_encode(&offpiste_features, features, valid, codes + OFFPISTE_CODE * cell);
    }
#else
    (void)cell;
#endif
    return codes;
}

static offpiste_map offpiste_map_of(const offpiste_parity* p, const float* codes) {
    offpiste_map map;
    map.grid.shift_x = -p->x, map.grid.shift_y = -p->y, map.grid.scale = 1.0f / p->resolution;
    map.grid.rows = (float)p->rows, map.grid.columns = (float)p->columns;
    map.slope = p->slope, map.codes = codes;
    map.missing = codes + (size_t)(OFFPISTE_CODES / 4) * p->rows * p->columns;
    memcpy(map.wheels, p->wheels, sizeof map.wheels);
    return map;
}

/* State of a drive at its start: what was measured, and what the networks remember of the past. */
static void offpiste_start_of(const offpiste_parity* p, const offpiste_map* map, int drive, float* state) {
    offpiste_given given[OFFPISTE_PAST];
    int row;
    memset(given, 0, sizeof given);
    memcpy(state, p->start + 10 * drive, 10 * sizeof(float));
    for (row = 0; row < p->past; row++) {
        const int at = drive * p->past + row;
        memcpy(given[row].control, p->past_controls + p->controls * at, sizeof given[row].control);
        offpiste_look(map, p->past_states + 10 * at, given + row);
    }
    offpiste_start(
        &offpiste_model, &offpiste_starts, p->past_states + 10 * p->past * drive, given, p->past, state);
}

/* Prints a drive, its largest distance from what was expected, and says whether all drives are near enough. */
static int offpiste_report(const offpiste_parity* p, const float* states) {
    float worst = 0.0f;
    int t, i, k, turned = 0;
    printf("time [s]   x [m]      y [m]      yaw [rad]  vx [m/s]   vy [m/s]   yaw rate [rad/s]\n");
    for (t = 24; t < p->steps; t += 25) {
        const float* s = states + 10 * t;
        printf("%-10.2f %-10.4f %-10.4f %-10.5f %-10.4f %-10.4f %-10.5f\n", 0.02 * (t + 1), s[0], s[1], s[2], s[3], s[4], s[5]);
    }
    for (i = 0; i < p->drives * p->steps; i++) {
        const float x = states[10 * i] - p->expected[10 * i], y = states[10 * i + 1] - p->expected[10 * i + 1];
        const float apart = x * x + y * y;
        if (apart > worst || apart != apart) worst = apart; /* NaN stays: nothing is larger */
        for (k = 2; k < 6; k++) turned |= !(fabsf(states[10 * i + k] - p->expected[10 * i + k]) <= 1e-3f);
    }
    printf("%d drives of %.1f s: at most %.2e m from what offpiste predicts\n", p->drives, 0.02 * p->steps, sqrt(worst));
    if (turned) printf("heading, velocities or yaw rate differ by more than 0.001\n");
    return worst <= 1e-6f && !turned ? 0 : 1;
}

#endif
