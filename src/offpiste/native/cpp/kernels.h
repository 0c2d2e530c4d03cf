/* Entries of the library for one instruction set, on chunks first ... last - 1. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <cmath>
#ifdef __x86_64__
#include <immintrin.h>
#endif

#ifndef OFFPISTE_COSTS
#define OFFPISTE_COSTS "costs.h"
#endif

#define OFFPISTE_ENTRY_OF(type, name) extern "C" __attribute__((visibility("default"))) type offpiste_##name
#define OFFPISTE_ENTRY(name) OFFPISTE_ENTRY_OF(void, name)

namespace {
#include "lanes.h"
#include "../../dynamics/header/elementary.h"
#include "../../dynamics/header/physics.h"
#include "../../dynamics/header/physics_adjoint.h"
#include "layout.h"
#include "products.h"
#include "model.h"
#include "recorded.h"
#include "encoder.h"
#include "ground.h"
#include "maps.h"
#include "controls.h"
#include "course.h"
#include "noise.h"
#include OFFPISTE_COSTS
#include "plan.h"
}

OFFPISTE_ENTRY(plan)(
    int first, int last, const Model* model, const Situation* situation, const Samples* samples) {
    roll_plan(first, last, *model, *situation, *samples);
}

#ifndef OFFPISTE_PLAN_ONLY
/* Digest of the sources (native/sources.py). */
OFFPISTE_ENTRY_OF(const char*, sources)() { return OFFPISTE_SOURCES; }

OFFPISTE_ENTRY(forward)(
    int first, int last, const Model* model, const Record* record, float* tape, float* states, float* actuators) {
    roll_forward(first, last, *model, *record, tape, states, actuators);
}

OFFPISTE_ENTRY(backward)(
    int first, int last, const Model* model, const Record* record, const float* tape, const float* states_bar,
    const float* actuators_bar, float* start_bar, float* codes_bar, float* constants_bar, const Learning* learning) {
    roll_backward(
        first, last, *model, *record, tape, states_bar, actuators_bar, start_bar, codes_bar, constants_bar, *learning);
}

OFFPISTE_ENTRY(encode)(int first, int last, const Encoder* encoder, const Cells* cells, float* codes) {
    encode_cells(first, last, *encoder, *cells, codes);
}

OFFPISTE_ENTRY(encode_back)(
    int first, int last, const Encoder* encoder, const Cells* cells, const float* codes_bar, float* first_bar,
    float* second_bar, float* last_bar) {
    encode_cells_back(first, last, *encoder, *cells, codes_bar, first_bar, second_bar, last_bar);
}

OFFPISTE_ENTRY(forward_on_maps)(
    int first, int last, const Model* model, const Maps* maps, const Encoder* encoder, float* states, float* actuators) {
    roll_on_maps(first, last, *model, *maps, *encoder, states, actuators);
}

OFFPISTE_ENTRY(keep_within)(int first, int last, const Bounds* bounds, const float* controls, float* kept) {
    keep_within(first, last, *bounds, controls, kept);
}

OFFPISTE_ENTRY(draw_noise)(int first, int last, const Colour* colour, float* noise) {
    draw_noise(first, last, *colour, noise);
}

OFFPISTE_ENTRY(fill_course)(int first, int last, const Path* path, float* result) {
    fill_course(first, last, *path, result);
}

/* Adds rows [count][size] to those that `cells` names. */
OFFPISTE_ENTRY(add_by_cell)(
    int, int, const float* rows, const long long* cells, int count, int size, float* sums) {
    for (long k = 0; k < count; k++)
        for (int e = 0; e < size; e++) sums[cells[k] * size + e] += rows[k * size + e];
}

#include "perception/filters.h"
#include "perception/occlusion.h"
#include "perception/scans.h"
#include "mapping/voxels.h"
#include "mapping/free_space.h"
#include "mapping/ghosts.h"
#include "mapping/columns.h"
#include "mapping/grids.h"
#include "mapping/planes.h"
#include "mapping/layers.h"
#include "simulation/grids.h"
#include "simulation/terrain.h"
#include "simulation/vectors.h"
#include "simulation/parameters.h"
#include "simulation/tyre.h"
#include "simulation/drivetrain.h"
#include "simulation/chassis.h"
#include "simulation/forces.h"
#include "simulation/rays.h"
#include "simulation/shading.h"
#include "simulation/camera.h"
#include "simulation/lidar.h"
#endif
