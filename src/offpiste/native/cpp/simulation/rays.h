/* Rays cast by Embree in packets, and what they hit (rendering/embree.py, rendering/scene.py). */

namespace {
namespace rays {

/* RTCRayHit8 or RTCRayHit16. */
template <int lanes>
struct alignas(64) Packet {
    float origin[3][lanes], nearest[lanes], direction[3][lanes], time[lanes], distance[lanes];
    int32_t mask[lanes], id[lanes], flags[lanes];
    float normal[3][lanes], u[lanes], v[lanes];
    int32_t face[lanes], part[lanes], instance[2][lanes];
};

/* rtcIntersect8 or 16, or rtcOccluded8 or 16, and the scene and arguments that it takes. */
struct Caster {
    void (*run)(const int32_t* used, void* scene, void* packet, void* arguments);
    void *scene, *arguments;
};

inline Caster caster_of(int64_t function, int64_t scene, int64_t arguments) {
    return {reinterpret_cast<decltype(Caster::run)>(function), (void*)scene, (void*)arguments};
}

/* Casts rays [count][3] from origins [count][3], or [1][3], each up to its distance, or without end.
   collect(packet, lane, ray): takes the result of each ray. */
template <int lanes, typename Collect>
void cast(
    const Caster& caster, int64_t origins, int64_t count, const float* origin, const float* direction,
    const float* distance, Collect collect) {
    alignas(64) int32_t used[lanes];
    Packet<lanes> packet = {};
    for (int lane = 0; lane < lanes; lane++) used[lane] = packet.mask[lane] = -1;
    for (int64_t first = 0; first < count; first += lanes) {
        const int inside = (int)std::min((int64_t)lanes, count - first);
        for (int lane = 0; lane < lanes; lane++) {
            const int64_t ray = first + std::min(lane, inside - 1);
            for (int axis = 0; axis < 3; axis++) {
                packet.origin[axis][lane] = origin[3 * (origins > 1 ? ray : 0) + axis];
                packet.direction[axis][lane] = direction[3 * ray + axis];
            }
            packet.distance[lane] = distance ? distance[ray] : INFINITY;
            packet.part[lane] = -1;
            if (lane >= inside) used[lane] = 0;
        }
        caster.run(used, caster.scene, &packet, caster.arguments);
        for (int lane = 0; lane < inside; lane++) collect(packet, lane, first + lane);
    }
}

template <int lanes>
void first_hits(
    const Caster& caster, int64_t origins, int64_t count, const float* origin, const float* direction, float* distance,
    int32_t* part, int32_t* face, float* normal) {
    cast<lanes>(
        caster, origins, count, origin, direction, distance, [=](const Packet<lanes>& packet, int lane, int64_t ray) {
            part[ray] = packet.part[lane];
            if (part[ray] < 0) return;
            distance[ray] = packet.distance[lane];
            face[ray] = packet.face[lane];
            for (int axis = 0; axis < 3; axis++) normal[3 * ray + axis] = packet.normal[axis][lane];
        });
}

template <int lanes>
void any_hits(
    const Caster& caster, int64_t origins, int64_t count, const float* origin, const float* direction, bool* blocked) {
    cast<lanes>(
        caster, origins, count, origin, direction, nullptr, [=](const Packet<lanes>& packet, int lane, int64_t ray) {
            blocked[ray] = packet.distance[lane] < 0; /* set by Embree on a hit */
        });
}

}
}

/* First hits nearer than `distance`, which they replace, with face and normal; part: -1 without a hit. */
OFFPISTE_ENTRY(first_hits)(
    int64_t function, int64_t scene, int64_t arguments, int64_t lanes, int64_t origins, int64_t count,
    const float* origin, const float* direction, float* distance, int32_t* part, int32_t* face, float* normal) {
    const rays::Caster caster = rays::caster_of(function, scene, arguments);
    const auto run = lanes == 16 ? rays::first_hits<16> : rays::first_hits<8>;
    run(caster, origins, count, origin, direction, distance, part, face, normal);
}

/* Whether each ray hits anything. */
OFFPISTE_ENTRY(any_hits)(
    int64_t function, int64_t scene, int64_t arguments, int64_t lanes, int64_t origins, int64_t count,
    const float* origin, const float* direction, bool* blocked) {
    const rays::Caster caster = rays::caster_of(function, scene, arguments);
    const auto run = lanes == 16 ? rays::any_hits<16> : rays::any_hits<8>;
    run(caster, origins, count, origin, direction, blocked);
}

/* Looks up surface and item of each hit; normals get unit length and point towards the origin.
   surfaces, first: surface of each part, and its first item in `items`. */
OFFPISTE_ENTRY(identify_hits)(
    int64_t count, const int32_t* part, const int32_t* face, const float* direction, const int8_t* surfaces,
    const int64_t* first, const int32_t* items, int8_t* surface, int32_t* item, float* normal) {
    for (int64_t ray = 0; ray < count; ray++) {
        if (part[ray] < 0) continue;
        surface[ray] = surfaces[part[ray]];
        item[ray] = items[first[part[ray]] + face[ray]];
        float* n = normal + 3 * ray;
        const float* d = direction + 3 * ray;
        const float length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        const float scale = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2] > 0 ? -1.0f : 1.0f) / length;
        for (int axis = 0; axis < 3; axis++) n[axis] *= scale;
    }
}
