/* Colours of rays whose hits are known (rendering/shading.py), with one ray in each lane of a vector. */

namespace {
namespace shading {

typedef offpiste_real Real;
typedef offpiste_whole Whole;

/* Indices of SURFACES, and channels of the ground's nodes (shading.py); LOW and HIGH are the first of three. */
enum Surface { SKY, GROUND, TRUNK, CROWN, BUSH, GRASS, BODY };
enum Channel { LOW, HIGH = 3, FINE = 6, COARSE, BUMPS, STONES, BLADES, RIPPLES, GLOSS, TRAIL, SUN, OPEN, CHANNELS };

constexpr int OCTAVES = 10, PERIOD = 128, LATTICE = PERIOD + 1; /* of the noise; nodes of its table along an axis */
constexpr float MOST_RELIEF = 0.5f;  /* relief and tone at which their channels saturate */
constexpr float TRAIL_REACH = 4.0f;  /* distance to a trail's centre line at which its channel saturates [m] */
constexpr float TRACK_OFFSET = 0.66f, TRACK_WIDTH = 0.17f; /* of tyre tracks, from the trail's centre line [m] */
constexpr float STONE_SIZE = 0.05f, BLADE_WIDTH = 0.012f, BLADE_LENGTH = 0.09f, RIPPLE_LENGTH = 0.13f; /* [m] */
constexpr float RAGGED = 0.12f;      /* amplitude of the borders between kinds of ground [m] */
constexpr float SHADOW_REACH = 8.0f; /* distance from the vehicle up to which its shadow is drawn [m] */

/* Appearance of the ground, at nodes [rows][columns] `resolution` apart, the first at (x0, y0). */
struct Ground {
    int64_t rows, columns;
    double x0, y0, resolution;
    const uint8_t* nodes;     /* [rows][columns][CHANNELS] */
    const float* elevation;   /* [rows][columns] [m] */
    const float* lattice;     /* random numbers in [-1, 1] [LATTICE][LATTICE] */
    const float (*turn)[2];   /* cosine and sine of each octave's angle, divided by its wavelength [OCTAVES] [1/m] */
    const float (*sun)[2];    /* horizontal direction to the sun in each octave's lattice [OCTAVES] */
    const float* soil;        /* colour between blades [3] */
    const float (*plants)[3]; /* colours of trunks, crowns and bushes; factor of blades on the ground below [4] */
};

struct Light {
    float sun[3], sun_colour[3], sky_colour[3], horizon_colour[3], zenith_colour[3];
    float haze, overcast, clouds[2], exposure, balance[3];
};

struct Vehicle {
    double position[3], rotation[3][3]; /* world_from_body */
    double sun[3];                      /* direction to the sun in the body frame, not along an axis */
};

static_assert(sizeof(Light) == 23 * sizeof(float) && sizeof(Vehicle) == 15 * sizeof(double), "as in shading.py");

/* Boxes of the vehicle: the lowest and highest corner of those that cast shadows, after a box around them; paint. */
struct Boxes {
    int64_t shadows, painted;
    const float (*shadow)[2][3]; /* [shadows] */
    const float (*paint)[3];     /* [painted] */
};

struct Scene {
    Ground ground;
    Light light;
    Vehicle vehicle;
    Boxes boxes;
    double origin[3]; /* of the rays [m] */
    float pixel;      /* angle of a pixel [rad] */
};

struct Hits {
    const float *ray, *distance;
    const int8_t* surface;
    const int32_t* item;
    const float* normal;
};

/* Clamps x to the limits; NaN becomes the lower one. */
inline float limited(float x, float low, float high) {
    x = x > low ? x : low;
    return x < high ? x : high;
}
inline Real limited(Real x, float low, float high) {
    x = x > low ? x : all_lanes(low);
    return x < high ? x : all_lanes(high);
}

inline Real real(Whole x) { return __builtin_convertvector(x, Real); }

/* Bytes as numbers, one in each lane. */
inline Real real(const uint8_t* bytes) {
#if OFFPISTE_WIDTH == 16
    return (Real)_mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)bytes)));
#elif OFFPISTE_WIDTH == 8
    return (Real)_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)bytes)));
#else
    Real found;
    for (int i = 0; i < OFFPISTE_WIDTH; i++) found[i] = bytes[i];
    return found;
#endif
}

inline Real look_up(const float* table, Whole at) {
#if OFFPISTE_WIDTH == 16
    return (Real)_mm512_mask_i32gather_ps(_mm512_setzero_ps(), 0xFFFF, (__m512i)at, table, 4);
#elif OFFPISTE_WIDTH == 8
    return (Real)_mm256_i32gather_ps(table, (__m256i)at, 4);
#else
    Real found;
    for (int i = 0; i < OFFPISTE_WIDTH; i++) found[i] = table[at[i]];
    return found;
#endif
}

/* e^x for -80 ... 80, with a relative error below 2e-7 (after Cephes' expf). */
inline Real exponential(Real x) {
    x = limited(x, -80.0f, 80.0f);
    const Real n = offpiste_floor(1.44269504f * x + 0.5f), r = (x - 0.693359375f * n) + 2.12194440e-4f * n;
    Real sum = 1.9875691500e-4f * r + 1.3981999507e-3f;
    for (const float term : {8.3334519073e-3f, 4.1665795894e-2f, 1.6666665459e-1f, 5.0000001201e-1f})
        sum = sum * r + term;
    return (sum * r * r + r + 1.0f) * (Real)((whole(n) + 127) << 23);
}

inline Real power(Real base, int exponent) {
    Real result = all_lanes(1.0f);
    for (; exponent; exponent >>= 1, base *= base)
        if (exponent & 1) result *= base;
    return result;
}

/* Pseudorandom number in [0, 1), after the finaliser of MurmurHash3. */
inline float hashed(int64_t i, int64_t j, int64_t seed) {
    uint64_t h = (uint64_t)i * 0x9E3779B97F4A7C15u + (uint64_t)j * 0xC2B2AE3D27D4EB4Fu + (uint64_t)seed;
    h = (h ^ (h >> 33)) * 0xFF51AFD7ED558CCDu;
    h = (h ^ (h >> 29)) * 0xC4CEB9FE1A85EC53u;
    return (float)(int32_t)(h >> 40) * (1.0f / 16777216.0f);
}

/* Index of cells of unit length in the periodic table of the noise, and places within them. */
struct Cell {
    Whole index;
    Real offset;
};

/* Moves a place, in cells, into the first period of the table; 0 for NaN and infinity. */
inline double wrapped(double place) {
    place -= PERIOD * std::floor(place / PERIOD);
    return place >= 0 ? place : 0.0;
}

/* Cells at some distances from a place, both in cells; the place needs double precision, distances do not. */
inline Cell cells_from(double place, Real distance) {
    const Real at = (float)wrapped(place) + distance, low = offpiste_floor(at);
    return {whole(low), at - low};
}

/* Index of a node of that table. */
inline Whole node_of(Whole column, Whole row) { return LATTICE * (row & (PERIOD - 1)) + (column & (PERIOD - 1)); }

struct Noise {
    Real value, slope_x, slope_y;
};

/* Smooth noise of unit wavelength in [-1, 1], and its slopes. */
inline Noise value_noise(const float* lattice, const Cell& along, const Cell& across) {
    const Whole node = node_of(along.index, across.index);
    const Real corner = look_up(lattice, node), u = along.offset, v = across.offset;
    const Real along_x = look_up(lattice + 1, node) - corner, along_y = look_up(lattice + LATTICE, node) - corner;
    const Real twist = look_up(lattice + LATTICE + 1, node) - corner - along_x - along_y;
    const Real s = u * u * (3.0f - 2.0f * u), t = v * v * (3.0f - 2.0f * v);
    return {
        corner + along_x * s + (along_y + twist * s) * t,
        (along_x + twist * t) * (6.0f * u * (1.0f - u)),
        (along_y + twist * s) * (6.0f * v * (1.0f - v))};
}

/* Brightness of round stones about one unit apart (Worley noise, SIGGRAPH 1996, over four cells). */
inline Real pebbles(const float* lattice, const Cell& along, const Cell& across) {
    Real nearest = all_lanes(9.0f), tone = {};
    for (int n = 0; n < 4; n++) {
        const int right = n & 1, far = n >> 1;
        const Whole i = along.index + right, j = across.index + far;
        const Real off_x = along.offset - (float)right - 0.42f * look_up(lattice, node_of(i, j));
        const Real off_y = across.offset - (float)far - 0.42f * look_up(lattice, node_of(j, i));
        const Real distance = off_x * off_x + off_y * off_y;
        tone = distance < nearest ? look_up(lattice, node_of(i, j + 64)) : tone;
        nearest = distance < nearest ? distance : nearest;
    }
    /* Large stones are rarer than small ones; stones are brightest in the middle. */
    return nearest < 0.16f + 0.10f * tone ? 0.5f * tone + 0.45f - nearest : all_lanes(-0.3f);
}

/* Position along an axis of the nodes, in nodes, kept on the grid; distance: from the origin of the rays [m]. */
inline Real on_nodes(const Ground& g, double origin, Real distance, double first, int64_t nodes) {
    const float per_metre = (float)(1 / g.resolution);
    return limited((float)((origin - first) / g.resolution) + per_metre * distance, 0.0f, (float)(nodes - 1));
}

/* Reads all channels at (x, y) from the origin of the rays, bilinear, 0..1; clamped at the border. */
inline void read_nodes(const Scene& s, Real x, Real y, Real* channel) {
    const Ground& g = s.ground;
    const Real at_x = on_nodes(g, s.origin[0], x, g.x0, g.columns), at_y = on_nodes(g, s.origin[1], y, g.y0, g.rows);
    const Whole left = whole(at_most(at_x, all_lanes((float)(g.columns - 2))));
    const Whole low = whole(at_most(at_y, all_lanes((float)(g.rows - 2))));
    const Real u = at_x - real(left), v = at_y - real(low);
    Real mixed[OFFPISTE_WIDTH][CHANNELS / OFFPISTE_WIDTH];
    for (int lane = 0; lane < OFFPISTE_WIDTH; lane++) {
        const uint8_t *near = g.nodes + CHANNELS * (low[lane] * g.columns + left[lane]), *far = near + CHANNELS * g.columns;
        for (int c = 0; c < CHANNELS; c += OFFPISTE_WIDTH) {
            const Real corner = real(near + c), above = real(far + c);
            const Real first = corner + u[lane] * (real(near + CHANNELS + c) - corner);
            const Real second = above + u[lane] * (real(far + CHANNELS + c) - above);
            mixed[lane][c / OFFPISTE_WIDTH] = (first + v[lane] * (second - first)) * (1.0f / 255);
        }
    }
    to_lanes([&](int lane) { return (const float*)mixed[lane]; }, CHANNELS, channel);
}

/* Which rays meet a box (slab test, Kay and Kajiya, SIGGRAPH 1986); inverse: of their direction. */
inline Whole meets(const float (*box)[3], const Real* from, const float* inverse) {
    Real enter = {}, leave = all_lanes(INFINITY);
    for (int axis = 0; axis < 3; axis++) {
        const Real low = (box[0][axis] - from[axis]) * inverse[axis], high = (box[1][axis] - from[axis]) * inverse[axis];
        enter = offpiste_maximum(enter, at_most(low, high));
        leave = at_most(leave, offpiste_maximum(low, high));
    }
    return enter < leave;
}

/* Rays of one kind of surface, one in each lane, and where they hit it. */
struct Seen {
    Whole index;
    Real ray[3], distance, phase; /* phase: cosine between reversed ray and sun */
    Real x, y, z;                 /* from the origin of the rays [m] */
};

/* 0 where places lie in the vehicle's shadow, else 1. */
inline Real sunlit(const Scene& s, const Seen& seen) {
    const double(&turn)[3][3] = s.vehicle.rotation;
    const double *origin = s.origin, *position = s.vehicle.position;
    const Real bx = (float)(origin[0] - position[0]) + seen.x, by = (float)(origin[1] - position[1]) + seen.y;
    const Real bz = (float)(origin[2] - position[2]) + seen.z;
    Whole shadow = {}, near = bx * bx + by * by < SHADOW_REACH * SHADOW_REACH;
    if (!any_lane(near)) return all_lanes(1.0f);
    Real from[3];
    float inverse[3];
    for (int axis = 0; axis < 3; axis++) {
        from[axis] = (float)turn[0][axis] * bx + (float)turn[1][axis] * by + (float)turn[2][axis] * bz;
        inverse[axis] = (float)(1 / s.vehicle.sun[axis]);
    }
    near &= meets(s.boxes.shadow[0], from, inverse);
    if (any_lane(near))
        for (int64_t box = 1; box < s.boxes.shadows; box++) shadow |= meets(s.boxes.shadow[box], from, inverse);
    return near & shadow ? Real{} : all_lanes(1.0f);
}

inline Seen see(const Scene& s, const Hits& hits, Whole index) {
    Seen seen;
    seen.index = index;
    seen.distance = look_up(hits.distance, index);
    seen.phase = Real{};
    for (int axis = 0; axis < 3; axis++) {
        seen.ray[axis] = look_up(hits.ray + axis, 3 * index);
        seen.phase -= seen.ray[axis] * s.light.sun[axis];
    }
    seen.x = seen.distance * seen.ray[0];
    seen.y = seen.distance * seen.ray[1];
    seen.z = seen.distance * seen.ray[2];
    return seen;
}

/* Adds haze over the distance to a colour. */
inline Real hazed(const Light& light, const Seen& seen, int k, Real colour) {
    return light.horizon_colour[k] + exponential(-light.haze * seen.distance) * (colour - light.horizon_colour[k]);
}

/* Noise of each octave and its slope towards the sun, faded where a pixel is too coarse. */
struct Octaves {
    Real value[OCTAVES], slope[OCTAVES];
};

/* finest: highest frequency that a pixel resolves (Nyquist) [1/m]. */
inline Octaves octaves_at(const Scene& s, const Seen& seen, Real finest) {
    const Ground& g = s.ground;
    Octaves found;
    for (int octave = OCTAVES - 1; octave >= 0; octave--) {
        const float cos = g.turn[octave][0], sin = g.turn[octave][1], wavelength = 1 / std::sqrt(cos * cos + sin * sin);
        const Real fade = limited(finest * wavelength - 1.0f, 0.0f, 1.0f);
        found.value[octave] = found.slope[octave] = Real{};
        if (!any_lane(fade > 0.0f)) continue;
        /* Lattices are turned and shifted so that they share neither axes nor origin. */
        const double along = cos * s.origin[0] + sin * s.origin[1] + octave * 17;
        const double across = cos * s.origin[1] - sin * s.origin[0] + octave * 29;
        const Cell column = cells_from(along, cos * seen.x + sin * seen.y);
        const Noise noise = value_noise(g.lattice, column, cells_from(across, cos * seen.y - sin * seen.x));
        found.value[octave] = fade * noise.value;
        found.slope[octave] = -fade * (noise.slope_x * g.sun[octave][0] + noise.slope_y * g.sun[octave][1]);
    }
    return found;
}

/* What the ground looks like before it is lit. */
struct Look {
    Real hue, tone, relief, bare; /* bare: share of soil visible between blades */
};

inline Look mix_octaves(const Real* value, const Real* slope, const Real* channel) {
    const Real share = value[9] - value[8] + value[7] - value[6] + value[5];
    const Real middle = 0.5f * (value[3] + value[4] + value[5]), fine = value[0] + value[1] + value[2] + middle;
    const Real coarse = value[6] + value[7] + value[8] + value[9] + middle;
    const Real bumps = slope[0] + slope[1] + slope[2] + slope[3] + slope[4] + slope[5];
    return {
        limited(0.5f + 0.35f * share, 0.0f, 1.0f), MOST_RELIEF * (channel[FINE] * fine + channel[COARSE] * coarse),
        MOST_RELIEF * channel[BUMPS] * bumps, Real{}};
}

/* Share in which a detail is drawn: 0 where there is less than 2 % of it, or pixels are as large as `coarsest` [m]. */
inline Real drawn(Real share, float coarsest, Real footprint) {
    return share > 0.02f ? share * limited(coarsest / footprint - 1.0f, 0.0f, 1.0f) : Real{};
}

/* Noise in the shape of blades: long cells, each turned by an angle about the origin of the world. */
inline Real blades_at(const Scene& s, const Seen& seen, Real angle) {
    const Real cos = offpiste_cos(angle), sin = offpiste_sin(angle);
    Cell along, across;
    for (int lane = 0; lane < OFFPISTE_WIDTH; lane++) {
        const double x = s.origin[0] + seen.x[lane], y = s.origin[1] + seen.y[lane];
        const double column = wrapped((cos[lane] * x + sin[lane] * y) / BLADE_WIDTH);
        const double row = wrapped((cos[lane] * y - sin[lane] * x) / BLADE_LENGTH);
        along.index[lane] = (int32_t)column;
        across.index[lane] = (int32_t)row;
        along.offset[lane] = (float)(column - (int32_t)column);
        across.offset[lane] = (float)(row - (int32_t)row);
    }
    return value_noise(s.ground.lattice, along, across).value;
}

/* Stones, blades and ripples, visible from nearby; footprint: size of pixels on the ground [m]. */
inline void add_details(
    const Scene& s, const Seen& seen, Real facing, Real footprint, const Real* value, const Real* channel, Look& look) {
    const double x = s.origin[0], y = s.origin[1];
    const Real stones = drawn(channel[STONES], STONE_SIZE / 2, footprint);
    if (any_lane(stones > 0.0f)) {
        const Cell along = cells_from(x / STONE_SIZE - 0.5, seen.x / STONE_SIZE + 0.25f * value[2]);
        const Cell across = cells_from(y / STONE_SIZE - 0.5, seen.y / STONE_SIZE + 0.25f * value[1]);
        look.tone += stones * pebbles(s.ground.lattice, along, across);
    }
    /* blades hide more soil at flatter view angles */
    look.bare = channel[BLADES] > 0.02f ? exponential(-3.0f * channel[BLADES] / facing) : Real{};
    const Real blades = drawn(channel[BLADES], 2 * BLADE_WIDTH, footprint);
    if (any_lane(blades > 0.0f)) look.tone += blades * blades_at(s, seen, 3.0f * value[8] + 1.5f * value[6]);
    const Real ripples = drawn(channel[RIPPLES], RIPPLE_LENGTH / 2, footprint);
    if (any_lane(ripples > 0.0f)) {
        const Real wander = 4.0f * value[9] + 2.5f * value[8] + 1.2f * value[7] + 0.5f * value[6];
        const Real distance = (0.8f * seen.x + 0.6f * seen.y) / RIPPLE_LENGTH + wander;
        const Real turns = cells_from((0.8 * x + 0.6 * y) / RIPPLE_LENGTH, distance).offset;
        look.relief += ripples * offpiste_cos(6.2831853f * turns) * (1.0f + value[6]);
    }
}

/* Tyre tracks along trails. */
inline void add_tracks(Real footprint, const Real* value, const Real* channel, Look& look) {
    const Real wander = 0.05f * (value[6] + 0.5f * value[4]);
    const Real off = (channel[TRAIL] * TRAIL_REACH - TRACK_OFFSET + wander) / TRACK_WIDTH;
    const Real bowl = offpiste_maximum(1.0f - 0.3f * off * off, 0.0f);
    const Real track = bowl * bowl * at_most(TRACK_WIDTH / footprint, all_lanes(1.0f));
    look.tone = look.tone * (1.0f - 0.5f * track) - 0.10f * track;
    look.relief *= 1.0f - 0.6f * track;
}

inline void shade_ground(const Scene& s, const Hits& hits, const Seen& seen, Real* out) {
    const Ground& g = s.ground;
    const Light& light = s.light;
    Real facing = {}, channel[CHANNELS];
    for (int axis = 0; axis < 3; axis++) facing -= seen.ray[axis] * look_up(hits.normal + axis, 3 * seen.index);
    facing = limited(facing, 0.02f, 1.0f);
    /* geometric mean of length and width */
    const Real footprint = offpiste_maximum(seen.distance * s.pixel / square_root(facing), 1e-4f);
    const Octaves octaves = octaves_at(s, seen, 0.5f / footprint);
    const Real* value = octaves.value;
    /* Borders between kinds are displaced by noise. */
    const Real along = seen.x + RAGGED * (value[6] + 0.5f * value[4]);
    const Real across = seen.y + RAGGED * (value[5] - 0.5f * value[3]);
    read_nodes(s, along, across, channel);
    Look look = mix_octaves(value, octaves.slope, channel);
    add_details(s, seen, facing, footprint, value, channel, look);
    add_tracks(footprint, value, channel, look);

    /* Rough ground is brightest seen along the sun, where no shadows are visible (Hapke, JGR 86, 1981). */
    const Real rough = limited(1.0f + look.relief, 0.15f, 2.0f), tone = offpiste_maximum(1.0f + look.tone, 0.25f);
    const Real sun = channel[SUN] * sunlit(s, seen) * rough * (1.0f + 0.25f * seen.phase);
    /* Schlick, Computer Graphics Forum 13, 1994 */
    const Real gloss = channel[GLOSS] * (0.02f + 0.98f * power(1.0f - facing, 5));
    for (int k = 0; k < 3; k++) {
        const Real root = channel[LOW + k] + look.hue * (channel[HIGH + k] - channel[LOW + k]);
        const Real surface = root * root + look.bare * (g.soil[k] - root * root);
        const Real lit = surface * tone * (sun * light.sun_colour[k] + light.sky_colour[k]);
        out[k] = hazed(light, seen, k, lit + gloss * (light.horizon_colour[k] - lit));
    }
}

/* Leaves, blades or trunks, lit from both sides and darker below. */
inline void shade_plants(const Scene& s, int kind, const Hits& hits, const Seen& seen, Real* out) {
    const Ground& g = s.ground;
    const Light& light = s.light;
    Real channel[CHANNELS], facing = {}, up = all_lanes(1.0f), own;
    read_nodes(s, seen.x, seen.y, channel);
    for (int lane = 0; lane < OFFPISTE_WIDTH; lane++) own[lane] = hashed(hits.item[seen.index[lane]], kind, 43);
    for (int axis = 0; axis < 3; axis++) facing += look_up(hits.normal + axis, 3 * seen.index) * light.sun[axis];
    if (kind != CROWN) {
        const Whole i = whole(on_nodes(g, s.origin[0], seen.x, g.x0, g.columns) + 0.5f);
        const Whole j = whole(on_nodes(g, s.origin[1], seen.y, g.y0, g.rows) + 0.5f);
        for (int lane = 0; lane < OFFPISTE_WIDTH; lane++) up[lane] = g.elevation[j[lane] * g.columns + i[lane]];
        up = (float)s.origin[2] + seen.z - up;
        up = limited(0.35f + 1.3f * up, 0.35f, 1.0f);
    }
    const Real side = magnitude(facing), normal = look_up(hits.normal + 2, 3 * seen.index);
    const Real sun = channel[OPEN] * sunlit(s, seen) * (0.25f + 0.75f * side) * up * (1.0f + 0.3f * seen.phase);
    const Real sky = up * (0.6f + 0.4f * magnitude(normal));
    for (int k = 0; k < 3; k++) {
        const Real root = channel[LOW + k] + own * (channel[HIGH + k] - channel[LOW + k]);
        const Real colour = g.plants[kind - TRUNK][k] * (0.7f + 0.6f * own) * (kind == GRASS ? root * root : all_lanes(1.0f));
        out[k] = hazed(light, seen, k, colour * (sun * light.sun_colour[k] + sky * light.sky_colour[k]));
    }
}

/* Brighter towards the horizon and the sun, with clouds. */
inline void shade_sky(const float* lattice, const Light& light, const Seen& seen, Real* out) {
    const Real rise = limited(seen.ray[2], 0.0f, 1.0f), flat = power(1.0f - rise, 4);
    const Real towards = offpiste_maximum(-seen.phase, 0.0f), glow = 0.25f * power(towards, 8) + 2.0f * power(towards, 300);
    const Real x = 0.8f * seen.ray[0] / (rise + 0.12f), y = 0.8f * seen.ray[1] / (rise + 0.12f);
    Real cloud = {};
    for (int octave = 0; octave < 4; octave++) {
        const float scale = (float)(1 << octave);
        const Cell along = cells_from(scale * light.clouds[0], scale * x);
        cloud += value_noise(lattice, along, cells_from(scale * light.clouds[1], scale * y)).value / scale;
    }
    cloud = limited(1.2f * (cloud + 2.0f * light.overcast - 0.9f), 0.0f, 1.0f) * at_most(8.0f * rise, all_lanes(1.0f));
    for (int k = 0; k < 3; k++) {
        const Real blue = light.zenith_colour[k] + flat * (light.horizon_colour[k] - light.zenith_colour[k]);
        const Real clear = blue + glow * light.sun_colour[k];
        out[k] = clear + 0.8f * cloud * (0.85f - clear);
    }
}

/* The vehicle itself, with the normal in the body frame. */
inline void shade_body(const Scene& s, const float* paint, const float* normal, float* out) {
    float facing = 0;
    for (int axis = 0; axis < 3; axis++) facing += normal[axis] * (float)s.vehicle.sun[axis];
    for (int k = 0; k < 3; k++) {
        const float sky = (0.6f + 0.4f * normal[2]) * s.light.sky_colour[k];
        out[k] = paint[k] * (0.8f * std::max(facing, 0.0f) * s.light.sun_colour[k] + sky);
    }
}

/* Shades rays of one kind of surface, and writes their colours to the rows `place` of `out`. */
inline void shade_lanes(const Scene& s, int kind, const Hits& hits, const int32_t* rays, const int32_t* place, float* out) {
    Whole index;
    memcpy(&index, rays, sizeof index);
    const Seen seen = see(s, hits, index);
    Real colour[3];
    if (kind == GROUND) shade_ground(s, hits, seen, colour);
    else if (kind == SKY) shade_sky(s.ground.lattice, s.light, seen, colour);
    else shade_plants(s, kind, hits, seen, colour);
    for (int lane = 0; lane < OFFPISTE_WIDTH; lane++)
        for (int k = 0; k < 3; k++) out[3 * (int64_t)place[rays[lane]] + k] = colour[k][lane];
}

inline void shade(const Scene& s, int32_t count, const Hits& hits, const int32_t* place, float* out) {
    int32_t index[BODY][OFFPISTE_WIDTH]; /* rays of each kind that wait until there is one for each lane */
    int waiting[BODY] = {};
    for (int32_t r = 0; r < count; r++) {
        const int32_t box = hits.item[r];
        int kind = hits.surface[r];
        if (kind == BODY && box >= 0 && box < s.boxes.painted) {
            shade_body(s, s.boxes.paint[box], hits.normal + 3 * r, out + 3 * (int64_t)place[r]);
            continue;
        }
        kind = kind > SKY && kind < BODY ? kind : SKY;
        index[kind][waiting[kind]++] = r;
        if (waiting[kind] == OFFPISTE_WIDTH) {
            shade_lanes(s, kind, hits, index[kind], place, out);
            waiting[kind] = 0;
        }
    }
    for (int kind = SKY; kind < BODY; kind++) {
        if (!waiting[kind]) continue;
        for (int lane = waiting[kind]; lane < OFFPISTE_WIDTH; lane++) index[kind][lane] = index[kind][0];
        shade_lanes(s, kind, hits, index[kind], place, out);
    }
}

}
}

/* Shades rays [count], linear RGB, into out[place[ray]]; normals of the vehicle itself are in the body frame. */
OFFPISTE_ENTRY(shade_rays)(
    int64_t rows, int64_t columns, double x0, double y0, double resolution, const uint8_t* nodes, const float* elevation,
    const float* lattice, const float* turn, const float* sun, const float* soil, const float* plants,
    const shading::Light* light, const shading::Vehicle* vehicle, int64_t shadows, const float* shadow, int64_t painted,
    const float* paint, double pixel_angle, const double* origin, int64_t count, const float* ray, const float* distance,
    const int8_t* surface, const int32_t* item, const float* normal, const int32_t* place, float* out) {
    const shading::Ground ground = {
        rows, columns, x0, y0, resolution, nodes, elevation, lattice, (const float(*)[2])turn, (const float(*)[2])sun,
        soil, (const float(*)[3])plants};
    const shading::Boxes boxes = {shadows, painted, (const float(*)[2][3])shadow, (const float(*)[3])paint};
    const shading::Scene scene = {
        ground, *light, *vehicle, boxes, {origin[0], origin[1], origin[2]}, (float)pixel_angle};
    shading::shade(scene, (int32_t)count, {ray, distance, surface, item, normal}, place, out);
}
