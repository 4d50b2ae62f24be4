// Cosine transforms of the rows of a map, some rows side by side: each as a Fourier transform of half its length (J. Makhoul, A
// fast cosine transform in one and two dimensions, IEEE Trans. ASSP 28, 1980), which is Stockham's: sorted as it goes.
#include "../../common.h"

enum { MOST_ODD = 7 };  // the largest prime that half a row's length may have

// One register holds this many rows. Each is computed on its own, so their number changes no bit.
#if defined(__AVX512F__)
enum { ROWS = 16 };
#elif defined(__AVX__)
enum { ROWS = 8 };
#else
enum { ROWS = 4 };
#endif
typedef float wide __attribute__((vector_size(ROWS * sizeof(float)), may_alias));
typedef float quad __attribute__((vector_size(4 * sizeof(float))));

typedef struct {
  wide re, im;
} many;  // complex numbers, one of each row

static inline many added(many a, many b) { return (many){a.re + b.re, a.im + b.im}; }
static inline many less(many a, many b) { return (many){a.re - b.re, a.im - b.im}; }
static inline many turned(many a, const float *by) { return (many){a.re * by[0] - a.im * by[1], a.re * by[1] + a.im * by[0]}; }

// All steps of a transform share this: `turns` (length, 2) holds exp(-2 pi i k / length).
struct fourier {
  const float *turns;
  ptrdiff_t length;
};

// One step: n values, `stride` transforms of them beside each other, are split into `radix` parts.
static void step_of_two(const struct fourier *f, const many *restrict x, many *restrict y, ptrdiff_t n, ptrdiff_t stride) {
  const ptrdiff_t part = n / 2, every = f->length / n;
  for (ptrdiff_t p = 0; p < part; p++)
    for (ptrdiff_t q = 0; q < stride; q++) {
      const many a = x[q + stride * p], b = x[q + stride * (p + part)];
      many *out = y + q + stride * 2 * p;
      out[0] = added(a, b);
      out[stride] = turned(less(a, b), f->turns + 2 * p * every);
    }
}

static void step_of_four(const struct fourier *f, const many *restrict x, many *restrict y, ptrdiff_t n, ptrdiff_t stride) {
  const ptrdiff_t part = n / 4, every = f->length / n;
  for (ptrdiff_t p = 0; p < part; p++)
    for (ptrdiff_t q = 0; q < stride; q++) {
      const many *in = x + q + stride * p;
      const many a = in[0], b = in[stride * part], c = in[2 * stride * part], d = in[3 * stride * part];
      const many ac = added(a, c), bd = added(b, d), left = less(a, c), right = less(b, d);
      many *out = y + q + stride * 4 * p;
      out[0] = added(ac, bd);
      out[stride] = turned((many){left.re + right.im, left.im - right.re}, f->turns + 2 * p * every);
      out[2 * stride] = turned(less(ac, bd), f->turns + 4 * p * every);
      out[3 * stride] = turned((many){left.re - right.im, left.im + right.re}, f->turns + 6 * p * every);
    }
}

static void step_of_odd(const struct fourier *f, const many *restrict x, many *restrict y, ptrdiff_t n, ptrdiff_t stride, int radix) {
  const ptrdiff_t part = n / radix, every = f->length / n, turn = f->length / radix;
  for (ptrdiff_t p = 0; p < part; p++)
    for (ptrdiff_t q = 0; q < stride; q++) {
      const many *in = x + q + stride * p;
      many sums[MOST_ODD / 2], differences[MOST_ODD / 2], *out = y + q + stride * radix * p;
      for (int k = 1; k <= radix / 2; k++) {
        sums[k - 1] = added(in[k * stride * part], in[(radix - k) * stride * part]);
        differences[k - 1] = less(in[k * stride * part], in[(radix - k) * stride * part]);
      }
      for (int j = 0; j < radix; j++) {
        many total = in[0];
        for (int k = 1; k <= radix / 2; k++) {
          const float *by = f->turns + 2 * turn * (j * k % radix);
          const many sum = sums[k - 1], difference = differences[k - 1];
          total.re += by[0] * sum.re - by[1] * difference.im;
          total.im += by[0] * sum.im + by[1] * difference.re;
        }
        out[j * stride] = turned(total, f->turns + 2 * p * j * every);
      }
    }
}

// The Fourier transform of x, with y as scratch; where the result is.
static many *transformed(const struct fourier *f, many *x, many *y) {
  for (ptrdiff_t n = f->length, stride = 1; n > 1;) {
    int radix = n % 4 == 0 ? 4 : n % 2 == 0 ? 2 : 3;
    while (n % radix) radix += 2;
    if (radix == 4) step_of_four(f, x, y, n, stride);
    else if (radix == 2) step_of_two(f, x, y, n, stride);
    else step_of_odd(f, x, y, n, stride, radix);
    n /= radix, stride *= radix;
    many *other = x;
    x = y, y = other;
  }
  return x;
}

static inline quad load_quad(const float *values) {
  quad x;
  memcpy(&x, values, sizeof x);
  return x;
}

// Four rows of four values, each `from` values apart, become columns, `to` values apart.
static inline void transpose(const float *rows, ptrdiff_t from, float *columns, ptrdiff_t to) {
  const quad a = load_quad(rows), b = load_quad(rows + from), c = load_quad(rows + 2 * from), d = load_quad(rows + 3 * from);
  const quad ac = {a[0], c[0], a[1], c[1]}, bd = {b[0], d[0], b[1], d[1]};
  const quad ac_behind = {a[2], c[2], a[3], c[3]}, bd_behind = {b[2], d[2], b[3], d[3]};
  const quad first = {ac[0], bd[0], ac[1], bd[1]}, second = {ac[2], bd[2], ac[3], bd[3]};
  const quad third = {ac_behind[0], bd_behind[0], ac_behind[1], bd_behind[1]};
  const quad fourth = {ac_behind[2], bd_behind[2], ac_behind[3], bd_behind[3]};
  memcpy(columns, &first, sizeof first), memcpy(columns + to, &second, sizeof second);
  memcpy(columns + 2 * to, &third, sizeof third), memcpy(columns + 3 * to, &fourth, sizeof fourth);
}

// `count` rows of w values, side by side in columns (w, ROWS); rows that are not there count as 0.
static void take_rows(const float *rows, float *columns, ptrdiff_t stride, ptrdiff_t count, ptrdiff_t w) {
  const ptrdiff_t whole_rows = count / 4 * 4, whole = w / 4 * 4;
  if (count < ROWS) memset(columns, 0, (size_t)(w * ROWS) * sizeof *columns);
  for (ptrdiff_t x = 0; x < whole; x += 4)
    for (ptrdiff_t i = 0; i < whole_rows; i += 4) transpose(rows + i * stride + x, stride, columns + x * ROWS + i, ROWS);
  for (ptrdiff_t i = 0; i < count; i++)
    for (ptrdiff_t x = i < whole_rows ? whole : 0; x < w; x++) columns[x * ROWS + i] = rows[i * stride + x];
}

static void give_rows(const float *columns, float *rows, ptrdiff_t stride, ptrdiff_t count, ptrdiff_t w) {
  const ptrdiff_t whole_rows = count / 4 * 4, whole = w / 4 * 4;
  for (ptrdiff_t x = 0; x < whole; x += 4)
    for (ptrdiff_t i = 0; i < whole_rows; i += 4) transpose(columns + x * ROWS + i, ROWS, rows + i * stride + x, stride);
  for (ptrdiff_t i = 0; i < count; i++)
    for (ptrdiff_t x = i < whole_rows ? whole : 0; x < w; x++) rows[i * stride + x] = columns[x * ROWS + i];
}

// Index of value j in the Fourier transformed sequence: even places upwards, then odd ones downwards.
static inline ptrdiff_t place_of(ptrdiff_t j, ptrdiff_t half) { return j < half ? 2 * j : 4 * half - 1 - 2 * j; }

// `twists` (half + 1, 4): exp(-2 pi i k / w) and exp(-pi i k / 2 w).
static void forward(const struct fourier *f, const float *twists, wide *columns, many *x, many *y) {
  const ptrdiff_t half = f->length;
  for (ptrdiff_t j = 0; j < half; j++) x[j] = (many){columns[place_of(2 * j, half)], columns[place_of(2 * j + 1, half)]};
  const many *z = transformed(f, x, y);
  for (ptrdiff_t k = 0; k <= half; k++) {
    const many a = z[k < half ? k : 0], b = z[k > 0 ? half - k : 0];
    const many even = {a.re + b.re, a.im - b.im}, odd = {a.im + b.im, b.re - a.re};  // twice what they are
    const many v = turned(added(even, turned(odd, twists + 4 * k)), twists + 4 * k + 2);
    columns[k] = v.re;
    if (k > 0 && k < half) columns[2 * half - k] = -v.im;
  }
}

static void inverse(const struct fourier *f, const float *twists, wide *columns, many *x, many *y) {
  const ptrdiff_t half = f->length;
  const float scale = 0.25f / (float)half;
  const wide none = {0};
  for (ptrdiff_t k = 0; k < half; k++) {
    const float *here = twists + 4 * k, *there = twists + 4 * (half - k);
    const float back[] = {here[2], -here[3]}, other_back[] = {there[2], -there[3]}, apart[] = {here[0], -here[1]};
    const many v = turned((many){columns[k], k > 0 ? -columns[2 * half - k] : none}, back);
    const many u = turned((many){columns[half - k], -columns[half + k]}, other_back);
    const many even = {v.re + u.re, v.im - u.im}, odd = turned((many){v.re - u.re, v.im + u.im}, apart);
    // real and imaginary part change places: the transform is then the inverse one, with its parts in each other's place
    x[k] = (many){scale * (even.im + odd.re), scale * (even.re - odd.im)};
  }
  const many *z = transformed(f, x, y);
  for (ptrdiff_t j = 0; j < half; j++) columns[place_of(2 * j, half)] = z[j].im, columns[place_of(2 * j + 1, half)] = z[j].re;
}

static bool is_smooth(ptrdiff_t n) {
  for (int p = 2; p <= MOST_ODD; p++)
    while (n % p == 0) n /= p;
  return n == 1;
}

// DCT-II of each row in place, not normalized, or its inverse; `w` is even, and half of it has no prime above MOST_ODD.
EXPORT int cosine_rows(float *rows, const float *turns, const float *twists, float *work, int32_t back, ptrdiff_t h, ptrdiff_t stride,
                       ptrdiff_t half, ptrdiff_t knots, ptrdiff_t n) {
  const struct fourier f = {turns, half};
  const ptrdiff_t w = 2 * half;
  if (half < 1 || !is_smooth(half) || knots != half + 1 || stride < w || n < (3 * w + 1) * LANES) return WRONG_SIZE;
  const size_t beyond = (uintptr_t)work % sizeof(wide);
  wide *columns = (wide *)((char *)work + (beyond ? sizeof(wide) - beyond : 0));
  many *x = (many *)(columns + w), *y = x + half;
  for (ptrdiff_t i = 0; i < h; i += ROWS) {
    const ptrdiff_t count = h - i < ROWS ? h - i : ROWS;
    take_rows(rows + i * stride, (float *)columns, stride, count, w);
    if (back) inverse(&f, twists, columns, x, y);
    else forward(&f, twists, columns, x, y);
    give_rows((const float *)columns, rows + i * stride, stride, count, w);
  }
  return OK;
}
