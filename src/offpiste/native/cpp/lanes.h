/* Vectors of OFFPISTE_WIDTH floats, one lane for each sample, and moves between lanes and rows of a batch. */
typedef float offpiste_real __attribute__((vector_size(4 * OFFPISTE_WIDTH)));
typedef int offpiste_whole __attribute__((vector_size(4 * OFFPISTE_WIDTH)));
typedef offpiste_real offpiste_stored __attribute__((aligned(4)));  /* in memory of a caller */
typedef float offpiste_four __attribute__((vector_size(16)));
typedef offpiste_four offpiste_stored_four __attribute__((aligned(4)));
#define OFFPISTE_REAL

#define OFFPISTE_INLINE static inline __attribute__((always_inline, unused))

OFFPISTE_INLINE offpiste_real all_lanes(float value) { return value - offpiste_real{}; }
OFFPISTE_INLINE offpiste_real load(const float* from) { return *(const offpiste_stored*)from; }
OFFPISTE_INLINE void store(float* to, offpiste_real values) { *(offpiste_stored*)to = values; }

OFFPISTE_INLINE offpiste_real offpiste_maximum(offpiste_real a, offpiste_real b) { return a > b ? a : b; }
OFFPISTE_INLINE offpiste_real offpiste_maximum(offpiste_real a, float b) { return offpiste_maximum(a, all_lanes(b)); }
OFFPISTE_INLINE offpiste_real magnitude(offpiste_real x) { return x < 0.0f ? -x : x; }

/* Derivative of the maximum by a; where both are equal 1/2, as autograd has it. */
OFFPISTE_INLINE offpiste_real offpiste_above(offpiste_real a, offpiste_real b) {
    return a > b ? all_lanes(1.0f) : (a == b ? all_lanes(0.5f) : all_lanes(0.0f));
}
OFFPISTE_INLINE offpiste_real offpiste_above(offpiste_real a, float b) { return offpiste_above(a, all_lanes(b)); }
OFFPISTE_INLINE offpiste_real offpiste_above(float a, offpiste_real b) { return offpiste_above(all_lanes(a), b); }

/* Largest whole number below x; beyond the range of int some number of that size. */
OFFPISTE_INLINE offpiste_real offpiste_floor(offpiste_real x) {
    const offpiste_real cut = __builtin_convertvector(__builtin_convertvector(x, offpiste_whole), offpiste_real);
    return cut > x ? cut - 1.0f : cut;
}

#if OFFPISTE_WIDTH == 16
OFFPISTE_INLINE offpiste_real square_root(offpiste_real x) { return (offpiste_real)_mm512_sqrt_ps((__m512)x); }
#elif OFFPISTE_WIDTH == 8
OFFPISTE_INLINE offpiste_real square_root(offpiste_real x) { return (offpiste_real)_mm256_sqrt_ps((__m256)x); }
#else
OFFPISTE_INLINE offpiste_real square_root(offpiste_real x) {
    for (int i = 0; i < OFFPISTE_WIDTH; i++) x[i] = __builtin_sqrtf(x[i]);
    return x;
}
#endif

/* Whether a condition, -1 or 0, holds in any lane. */
OFFPISTE_INLINE bool any_lane(offpiste_whole condition) {
#if OFFPISTE_WIDTH == 16
    return _mm512_movepi32_mask((__m512i)condition);
#elif OFFPISTE_WIDTH == 8
    return _mm256_movemask_ps((__m256)condition);
#else
    int found = 0;
    for (int i = 0; i < OFFPISTE_WIDTH; i++) found |= condition[i];
    return found;
#endif
}

OFFPISTE_INLINE float sum_of_lanes(offpiste_real x) {
    float sum = 0.0f;
    for (int i = 0; i < OFFPISTE_WIDTH; i++) sum += x[i];
    return sum;
}

/* Where lanes read an array: at 32-bit offsets from its start, which take less arithmetic than pointers. */
struct Places {
    alignas(64) int at[OFFPISTE_WIDTH];
    explicit Places(offpiste_whole offsets) { *(offpiste_whole*)at = offsets; }
};

/* Numbers k ... k + 3 of a row for each lane, in groups of 16 bytes: group g has those of lanes g, g + 4, ... */
template <class Row>
OFFPISTE_INLINE offpiste_real join_fours(const Row& row, int group, int k) {
#if OFFPISTE_WIDTH == 16
    __m512 joined = _mm512_castps128_ps512(_mm_loadu_ps(row(group) + k));
    joined = _mm512_insertf32x4(joined, _mm_loadu_ps(row(group + 4) + k), 1);
    joined = _mm512_insertf32x4(joined, _mm_loadu_ps(row(group + 8) + k), 2);
    return (offpiste_real)_mm512_insertf32x4(joined, _mm_loadu_ps(row(group + 12) + k), 3);
#elif OFFPISTE_WIDTH == 8
    const __m256 low = _mm256_castps128_ps256(_mm_loadu_ps(row(group) + k));
    return (offpiste_real)_mm256_insertf128_ps(low, _mm_loadu_ps(row(group + 4) + k), 1);
#else
    return load(row(group) + k);
#endif
}

#if OFFPISTE_WIDTH == 16
#define OFFPISTE_PICK(a, b, i, j, k, l) \
    (offpiste_real) _mm512_shuffle_ps((__m512)(a), (__m512)(b), i | j << 2 | k << 4 | l << 6)
#elif OFFPISTE_WIDTH == 8
#define OFFPISTE_PICK(a, b, i, j, k, l) \
    (offpiste_real) _mm256_shuffle_ps((__m256)(a), (__m256)(b), i | j << 2 | k << 4 | l << 6)
#elif defined(__clang__)
#define OFFPISTE_PICK(a, b, i, j, k, l) __builtin_shufflevector(a, b, i, j, 4 + k, 4 + l)
#else
#define OFFPISTE_PICK(a, b, i, j, k, l) __builtin_shuffle(a, b, offpiste_whole{i, j, 4 + k, 4 + l})
#endif

/* Transposes the 4 x 4 numbers in each 16 bytes of four vectors. */
OFFPISTE_INLINE void transpose_fours(offpiste_real* r) {
    const offpiste_real a = OFFPISTE_PICK(r[0], r[1], 0, 1, 0, 1), b = OFFPISTE_PICK(r[2], r[3], 0, 1, 0, 1);
    const offpiste_real c = OFFPISTE_PICK(r[0], r[1], 2, 3, 2, 3), d = OFFPISTE_PICK(r[2], r[3], 2, 3, 2, 3);
    r[0] = OFFPISTE_PICK(a, b, 0, 2, 0, 2);
    r[1] = OFFPISTE_PICK(a, b, 1, 3, 1, 3);
    r[2] = OFFPISTE_PICK(c, d, 0, 2, 0, 2);
    r[3] = OFFPISTE_PICK(c, d, 1, 3, 1, 3);
}

/* Rows of `count` numbers, row(i) for lane i, as `count` vectors. Vectors are joined in registers: processors stall
   where one is read that was written in parts. */
template <class Row>
OFFPISTE_INLINE void to_lanes(const Row& row, int count, offpiste_real* out) {
    int k = 0;
    for (; k + 4 <= count; k += 4) {
        for (int group = 0; group < 4; group++) out[k + group] = join_fours(row, group, k);
        transpose_fours(out + k);
    }
    for (; k < count; k++)
        for (int i = 0; i < OFFPISTE_WIDTH; i++) ((float*)(out + k))[i] = row(i)[k];
}

OFFPISTE_INLINE void to_lanes(const float* array, const Places& places, int count, offpiste_real* out) {
    to_lanes([&](int i) { return array + places.at[i]; }, count, out);
}

/* The first `inside` lanes of `count` vectors as rows. */
OFFPISTE_INLINE void from_lanes(const offpiste_real* in, int count, int inside, float* const* rows) {
    int k = 0;
    for (; k + 4 <= count; k += 4) {
        offpiste_real fours[4] = {in[k], in[k + 1], in[k + 2], in[k + 3]};
        transpose_fours(fours);
        for (int i = 0; i < inside; i++)
            *(offpiste_stored_four*)(rows[i] + k) = *(const offpiste_four*)((const float*)(fours + i % 4) + i / 4 * 4);
    }
    for (; k < count; k++)
        for (int i = 0; i < inside; i++) rows[i][k] = in[k][i];
}

/* Memory for vectors, freed at the end of a scope. */
struct Vectors {
    offpiste_real* at;
    explicit Vectors(size_t count) {
        const size_t bytes = (count * sizeof(offpiste_real) + 64) / 64 * 64;
        at = (offpiste_real*)aligned_alloc(64, bytes);
        if (!at) abort();
        memset(at, 0, bytes);
    }
    Vectors(const Vectors&) = delete;
    ~Vectors() { free(at); }
    operator offpiste_real*() const { return at; }
};

enum { CHUNK = 32 }; /* samples that one thread takes at a time */

/* Samples of a batch in the lanes of a vector. */
struct Block {
    int first, inside;
    long window[OFFPISTE_WIDTH]; /* lanes behind the batch repeat its last sample */
    offpiste_real weight;        /* 1, behind the batch 0 */
};

OFFPISTE_INLINE Block block_at(int first, int batch) {
    Block b;
    b.first = first;
    b.inside = batch - first < OFFPISTE_WIDTH ? batch - first : OFFPISTE_WIDTH;
    for (int i = 0; i < OFFPISTE_WIDTH; i++) {
        b.window[i] = first + i < batch ? first + i : batch - 1;
        b.weight[i] = first + i < batch ? 1.0f : 0.0f;
    }
    return b;
}

OFFPISTE_INLINE void load_rows(const float* rows, const Block& b, long apart, long at, int count, offpiste_real* out) {
    to_lanes([&](int i) { return rows + b.window[i] * apart + at; }, count, out);
}

OFFPISTE_INLINE void store_rows(const offpiste_real* in, const Block& b, long apart, long at, int count, float* rows) {
    float* to[OFFPISTE_WIDTH];
    for (int i = 0; i < OFFPISTE_WIDTH; i++) to[i] = rows + b.window[i] * apart + at;
    from_lanes(in, count, b.inside, to);
}
