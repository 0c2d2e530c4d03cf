/* The library for one instruction set. Entries that take `first` and `last` work on chunks first ... last - 1; entries
   take structures by reference, which callers pass as addresses. */
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
#include "ground.h"
#include OFFPISTE_COSTS
}
#include "plan.h"

#ifndef OFFPISTE_PLAN_ONLY
/* Digest of the sources (native/sources.py). */
OFFPISTE_ENTRY_OF(const char*, sources)() { return OFFPISTE_SOURCES; }

/* Adds rows [count][size] to those that `cells` names. */
OFFPISTE_ENTRY(add_by_cell)(
    int, int, const float* rows, const long long* cells, int count, int size, float* sums) {
    for (long k = 0; k < count; k++)
        for (int e = 0; e < size; e++) sums[cells[k] * size + e] += rows[k * size + e];
}

#include "recorded.h"
#include "encoder.h"
#include "maps.h"
#include "controls.h"
#include "course.h"
#include "noise.h"
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
