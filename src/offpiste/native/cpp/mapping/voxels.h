/* The voxel map and its insertion of points; layouts and constants are those of mapping/voxel_map.py. */
namespace {
constexpr int64_t LEVELS = 31, PARTS = 2, STRIPE = 3, ALL_LEVELS = (int64_t(1) << LEVELS) - 1;

struct Head {
    int32_t base, occupied, featured, lowest;
};

struct Voxel {
    float x, y, z, distance, feature_distance, hits, feature_hits, passed;
    float* features() { return reinterpret_cast<float*>(this + 1); }
};

struct PartCounts {
    int64_t ever, freed, lost;
};

struct Voxels {
    Head* heads;
    int32_t *changed, *slots;
    float* seen;
    int32_t* freed;
    PartCounts* counts;
    int64_t cells, width, part_slots;

    Voxel& voxel(int64_t slot) const { return *reinterpret_cast<Voxel*>(seen + slot * width); }
    int32_t* column_slots(int64_t cell) const { return slots + cell * (LEVELS + 1); }
};

inline int64_t wrapped(int64_t coordinate, int64_t cells) {
    const int64_t rest = coordinate % cells;
    return rest < 0 ? rest + cells : rest;
}

inline int64_t part_of_row(int64_t row) { return (row >> STRIPE) % PARTS; }

/* Takes a free slot of a part; -1 if it is full. */
inline int64_t take_slot(const Voxels& voxels, int64_t part) {
    PartCounts& counts = voxels.counts[part];
    if (counts.freed > 0) return voxels.freed[part * voxels.part_slots + --counts.freed];
    if (counts.ever == voxels.part_slots) {
        counts.lost++;
        return -1;
    }
    return part * voxels.part_slots + counts.ever++;
}

inline void release_slot(const Voxels& voxels, int64_t part, int32_t slot) {
    voxels.freed[part * voxels.part_slots + voxels.counts[part].freed++] = slot;
}

/* Shifts a column for a new lowest voxel `by` levels below, and releases voxels above the top level. */
inline void lower_column(const Voxels& voxels, int64_t part, Head& head, int32_t* slots, int64_t by) {
    for (int64_t level = LEVELS - 1; level >= 0; level--) {
        if (!(head.occupied >> level & 1)) continue;
        if (level + by < LEVELS) slots[level + by] = slots[level];
        else release_slot(voxels, part, slots[level]);
    }
    const int64_t shift = std::min(by, LEVELS);
    head.occupied = int32_t((int64_t(head.occupied) << shift) & ALL_LEVELS);
    head.featured = int32_t((int64_t(head.featured) << shift) & ALL_LEVELS);
    head.base = int32_t(head.base - by);
}

/* Finds or creates the voxel at a level; returns its slot, -1 without room, and writes the levels above the lowest. */
inline int64_t slot_at(const Voxels& voxels, int64_t part, int64_t cell, int64_t level, int64_t& up) {
    Head& head = voxels.heads[cell];
    up = head.occupied ? level - head.base : 0;
    if (up >= LEVELS) return -1;
    if (up == 0 && head.occupied) return head.lowest;
    int32_t* slots = voxels.column_slots(cell);
    if (up > 0 && head.occupied >> up & 1) return slots[up];
    const int64_t slot = take_slot(voxels, part);
    if (slot < 0) return slot;
    if (!head.occupied) {
        head.base = int32_t(level);
        head.featured = 0;
    } else if (up < 0) {
        lower_column(voxels, part, head, slots, -up);
        up = 0;
    }
    if (up == 0) head.lowest = int32_t(slot);
    slots[up] = int32_t(slot);
    head.occupied |= int32_t(1) << up;
    Voxel& voxel = voxels.voxel(slot);
    voxel.distance = voxel.feature_distance = INFINITY;
    voxel.hits = voxel.feature_hits = voxel.passed = 0;
    return slot;
}

/* The fusion rules of mapping/voxel_map.py. */
inline float share_of_new(int64_t rule, float distance, float held_distance, float count) {
    return rule == 0 ? float(distance < held_distance) : rule == 1 ? 1.0f : 1.0f / count;
}

inline void fuse(float& held, float value, float share) { held = share == 1 ? value : held + (value - held) * share; }

struct Cloud {
    const double* points;
    const float* features;
    const bool* has_feature;
    const float* distance;
    int64_t channels;
};

/* A point's voxel, and its place in it [voxels]. */
struct Target {
    int64_t point, part, cell, level;
    float x, y, z;
};

inline bool all_finite(const float* values, int64_t count) {
    float total = 0;
    for (int64_t k = 0; k < count; k++) total += values[k] - values[k];
    return total == 0;
}

inline void insert_point(const Voxels& voxels, const Cloud& cloud, int64_t rule, const Target& at, int32_t number) {
    int64_t up;
    const int64_t slot = slot_at(voxels, at.part, at.cell, at.level, up);
    if (slot < 0) return;
    Voxel& voxel = voxels.voxel(slot);
    const float distance = cloud.distance[at.point];
    voxel.passed = 0;
    float share = ++voxel.hits > 1 ? share_of_new(rule, distance, voxel.distance, voxel.hits) : 1;
    bool changed = share != 0;
    if (changed) {
        fuse(voxel.x, at.x, share);
        fuse(voxel.y, at.y, share);
        fuse(voxel.z, at.z, share);
        fuse(voxel.distance, distance, share);
    }
    const float* features = cloud.features ? cloud.features + at.point * cloud.channels : nullptr;
    if (features && cloud.has_feature[at.point] && all_finite(features, cloud.channels)) {
        voxels.heads[at.cell].featured |= int32_t(1) << up;
        share = ++voxel.feature_hits > 1 ? share_of_new(rule, distance, voxel.feature_distance, voxel.feature_hits) : 1;
        if (share != 0) {
            fuse(voxel.feature_distance, distance, share);
            for (int64_t k = 0; k < cloud.channels; k++) fuse(voxel.features()[k], features[k], share);
            changed = true;
        }
    }
    if (changed) voxels.changed[at.cell] = number;
}
}

OFFPISTE_ENTRY(insert_points)(
    int64_t first, int64_t last, int64_t rule, const double* points, const float* features, const bool* has_feature,
    const float* distance, int64_t count, int64_t channels, const int64_t* low, double middle, double reach,
    double scale, int64_t number, Head* heads, int32_t* changed, int32_t* slots, float* seen, int32_t* freed,
    PartCounts* counts, int64_t cells, int64_t width, int64_t part_slots) {
    const Voxels voxels{heads, changed, slots, seen, freed, counts, cells, width, part_slots};
    const Cloud cloud{points, features, has_feature, distance, channels};
    const int64_t start_x = wrapped(low[0], cells), start_y = wrapped(low[1], cells);
    const double n = double(cells);
    Target targets[64]; /* so that their memory is fetched at the same time */
    for (int64_t begin = 0; begin < count; begin += 64) {
        int64_t found = 0;
        for (int64_t i = begin; i < std::min(begin + 64, count); i++) {
            const double y = points[3 * i + 1] * scale, cell_y = floor(y) - double(low[1]);
            if (!(cell_y >= 0 && cell_y < n)) continue; /* NaN as well */
            int64_t row = start_y + int64_t(cell_y);
            row = row >= cells ? row - cells : row;
            const int64_t part = part_of_row(row);
            if (part < first || part >= last) continue;
            const double x = points[3 * i] * scale, cell_x = floor(x) - double(low[0]);
            const double z = points[3 * i + 2] * scale, level = floor(z);
            if (!(cell_x >= 0 && cell_x < n) || !(fabs(points[3 * i + 2] - middle) <= reach) || !(fabs(level) < 1e9) ||
                !(distance[i] >= 0 && distance[i] < INFINITY))
                continue;
            int64_t column = start_x + int64_t(cell_x);
            column = column >= cells ? column - cells : column;
            __builtin_prefetch(heads + row * cells + column);
            targets[found++] = {i, part, row * cells + column, int64_t(level),
                float(x - floor(x) - 0.5), float(y - floor(y) - 0.5), float(z - level)};
        }
        for (int64_t k = 0; k < found; k++) {
            const Head& head = heads[targets[k].cell];
            if (head.occupied) __builtin_prefetch(&voxels.voxel(head.lowest));
        }
        for (int64_t k = 0; k < found; k++) insert_point(voxels, cloud, rule, targets[k], int32_t(number));
    }
}
