/* Coloured noise (planning/noise.py): random coefficients, and their Fourier transform with one series in each lane.

   Real and imaginary parts of a transform are independent series: of a sample, and of the one half a chunk further on,
   so that numbers do not depend on the width of vectors. */
namespace {
typedef unsigned offpiste_bits __attribute__((vector_size(4 * OFFPISTE_WIDTH)));

struct Colour {
    const float* deviation; /* [frequencies], of real and imaginary parts */
    const float* roots;     /* [period][2], of unity */
    int frequencies, period, samples, steps, controls;
    uint64_t seed;
};

struct Complex {
    offpiste_real re, im;
};

/* Threefry-4x32-20 (Salmon et al., SC 2011): a generator without state, by additions and rotations alone. */
OFFPISTE_INLINE void randomize(uint64_t seed, unsigned counter, offpiste_bits series, offpiste_bits x[4]) {
    const int turns[8][2] = {{10, 26}, {11, 21}, {13, 27}, {23, 5}, {6, 20}, {17, 11}, {25, 10}, {18, 20}};
    const unsigned low = (unsigned)seed, high = (unsigned)(seed >> 32);
    const unsigned key[5] = {low, high, 0, 0, 0x1BD11BDA ^ low ^ high};
    const offpiste_bits none = {};
    x[0] = none + (counter + key[0]);
    x[1] = series + key[1];
    x[2] = x[3] = none;
#pragma GCC unroll 20
    for (int round = 0; round < 20; round++) {
        offpiste_bits &first = x[round % 2 ? 3 : 1], &second = x[round % 2 ? 1 : 3];
        const int *turn = turns[round % 8];
        x[0] += first;
        first = (first << turn[0] | first >> (32 - turn[0])) ^ x[0];
        x[2] += second;
        second = (second << turn[1] | second >> (32 - turn[1])) ^ x[2];
        if (round % 4 == 3) {
            const unsigned past = round / 4 + 1;
            for (int i = 0; i < 4; i++) x[i] += key[(past + i) % 5] + (i == 3 ? past : 0);
        }
    }
}

/* In [0, 1). */
OFFPISTE_INLINE offpiste_real uniform(offpiste_bits bits) {
    return __builtin_convertvector((offpiste_whole)(bits >> 8), offpiste_real) * 0x1p-24f;
}

/* Natural logarithm of positive numbers, to 1e-7 (Cephes' logf). */
OFFPISTE_INLINE offpiste_real logarithm(offpiste_real x) {
    const offpiste_whole bits = (offpiste_whole)x;
    offpiste_real power = __builtin_convertvector((bits >> 23) - 127, offpiste_real);
    offpiste_real f = (offpiste_real)((bits & 0x7fffff) | 0x3f800000); /* 1 to 2 */
    const offpiste_whole large = f > 1.41421356f;
    f = (large ? 0.5f * f : f) - 1.0f;
    power += large ? all_lanes(1.0f) : offpiste_real{};
    offpiste_real p = all_lanes(7.0376836292e-2f);
    const float factors[] = {-1.1514610310e-1f, 1.1676998740e-1f,  -1.2420140846e-1f, 1.4249322787e-1f,
                             -1.6668057665e-1f, 2.0000714765e-1f, -2.4999993993e-1f, 3.3333331174e-1f};
    for (const float factor : factors) p = p * f + factor;
    return f + f * f * (p * f - 0.5f) + power * 0.69314718f;
}

/* Two standard normal numbers (Box and Muller), their angle from -pi to pi by series of its half. */
OFFPISTE_INLINE Complex normal(offpiste_bits one, offpiste_bits other) {
    const offpiste_real radius = square_root(-2.0f * logarithm(1.0f - uniform(one)));
    const offpiste_real half = 3.14159265f * (uniform(other) - 0.5f), square = half * half;
    offpiste_real sine = all_lanes(-2.50521084e-8f), cosine = all_lanes(2.08767570e-9f);
    const float of_sine[] = {2.75573192e-6f, -1.98412698e-4f, 8.33333333e-3f, -0.166666667f, 1.0f};
    const float of_cosine[] = {-2.75573192e-7f, 2.48015873e-5f, -1.38888889e-3f, 4.16666667e-2f, -0.5f, 1.0f};
    for (const float factor : of_sine) sine = sine * square + factor;
    for (const float factor : of_cosine) cosine = cosine * square + factor;
    sine *= half;
    return {radius * (1.0f - 2.0f * sine * sine), radius * (2.0f * sine * cosine)};
}

/* Coefficients [period], zero above the highest frequency; those of frequency -k are at period - k. */
void draw_coefficients(const Colour& c, offpiste_bits series, Complex* z) {
    memset((void*)z, 0, c.period * sizeof *z);
    for (int k = 0; k < c.frequencies; k++) {
        offpiste_bits drawn[4];
        randomize(c.seed, k, series, drawn);
        const Complex up = normal(drawn[0], drawn[1]), down = normal(drawn[2], drawn[3]);
        z[k] = {c.deviation[k] * up.re, c.deviation[k] * up.im};
        if (k > 0 && 2 * k < c.period) z[c.period - k] = {c.deviation[k] * down.re, c.deviation[k] * down.im};
    }
}

/* One stage of Stockham's transform, of `length` points in `apart` interleaved series: sums over `radix` of them. */
template <int R>
OFFPISTE_INLINE void sum_points(
    int radix, const float* roots, int length, int apart, const Complex* from, Complex* to, Complex* scratch) {
    const int r = R ? R : radix, period = length * apart, parts = length / r;
    Complex own[R ? R : 1], *a = R ? own : scratch;
    for (int p = 0; p < parts; p++)
        for (int q = 0; q < apart; q++) {
            for (int k = 0; k < r; k++) a[k] = from[q + apart * (p + parts * k)];
            for (int j = 0; j < r; j++) {
                Complex sum = a[0];
                for (int k = 1; k < r; k++) {
                    const float* root = roots + 2L * (j * k % r) * (period / r);
                    sum.re += root[0] * a[k].re - root[1] * a[k].im;
                    sum.im += root[0] * a[k].im + root[1] * a[k].re;
                }
                const float* turn = roots + 2L * p * j * apart;
                to[q + apart * (r * p + j)] = {
                    turn[0] * sum.re - turn[1] * sum.im, turn[0] * sum.im + turn[1] * sum.re};
            }
        }
}

/* Transforms z to sum_k z[k] exp(2 pi i k t / period); returns the one of the two arrays with the result. */
Complex* transform(int period, const float* roots, Complex* z, Complex* other, Complex* scratch) {
    int length = period, apart = 1, radix = 2;
    while (length > 1) {
        while (length % radix) radix++;
        switch (radix) {
            case 2: sum_points<2>(2, roots, length, apart, z, other, scratch); break;
            case 3: sum_points<3>(3, roots, length, apart, z, other, scratch); break;
            case 5: sum_points<5>(5, roots, length, apart, z, other, scratch); break;
            default: sum_points<0>(radix, roots, length, apart, z, other, scratch);
        }
        Complex* before = z;
        z = other;
        other = before;
        length /= radix;
        apart *= radix;
    }
    return z;
}
}

/* noise: [samples][steps][controls]. */
OFFPISTE_ENTRY(draw_noise)(int first, int last, const Colour& c, float* noise) {
    const int row = c.steps * c.controls;
    Vectors room(6 * (size_t)c.period), real(row), imaginary(row);
    Complex *z = (Complex*)(offpiste_real*)room, *other = z + c.period, *scratch = other + c.period;
    for (int chunk = first; chunk < last; chunk++)
        for (int lane = 0; lane < CHUNK / 2; lane += OFFPISTE_WIDTH) {
            for (int u = 0; u < c.controls; u++) {
                offpiste_bits series;
                for (int i = 0; i < OFFPISTE_WIDTH; i++) series[i] = (chunk * CHUNK / 2 + lane + i) * c.controls + u;
                draw_coefficients(c, series, z);
                const Complex* drawn = transform(c.period, c.roots, z, other, scratch);
                for (int t = 0; t < c.steps; t++) {
                    real[t * c.controls + u] = drawn[t].re;
                    imaginary[t * c.controls + u] = drawn[t].im;
                }
            }
            const int at = chunk * CHUNK + lane;
            store_rows(real, block_at(at, c.samples), row, 0, row, noise);
            store_rows(imaginary, block_at(at + CHUNK / 2, c.samples), row, 0, row, noise);
        }
}
