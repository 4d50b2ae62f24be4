// surface -> pressure that holds it up, its mean around each pixel, and where it ends: the outline of contacts.
#include "steps.h"

// Sums over squares of SIDE x SIDE pixels around each pixel, of the rows of some maps one after the other; nothing is outside of the
// frame. A sum along a side is one of THIRD sums, of each three values.
enum { THIRD = 3, SIDE = THIRD * THIRD, REACH = SIDE / 2, LAST = SIDE - THIRD + 1 };

struct window {
  float *padded, *threes, *rows, *sums;  // a map's row with REACH zeros before it; sums of three values; rings of rows
  ptrdiff_t maps, w, stride;
};

static inline ptrdiff_t whole(ptrdiff_t n) { return (n + LANES - 1) / LANES * LANES; }

// Floats of a row of work, and of a window's work.
static inline ptrdiff_t stride_of(ptrdiff_t w) { return whole(w) + LANES; }
static inline ptrdiff_t window_work(ptrdiff_t maps, ptrdiff_t w) { return (1 + maps * (1 + THIRD + LAST)) * stride_of(w) + LANES; }

static struct window window_in(float *work, ptrdiff_t maps, ptrdiff_t w) {
  const ptrdiff_t stride = stride_of(w);
  float *padded = work + stride + LANES;
  memset(work, 0, (size_t)window_work(maps, w) * sizeof *work);
  return (struct window){padded, work, padded + maps * stride, padded + maps * (1 + THIRD) * stride, maps, w, stride};
}

static inline float *row_of(const struct window *o, ptrdiff_t map) { return o->padded + map * o->stride + REACH; }

static inline float *in_ring(float *ring, const struct window *o, ptrdiff_t map, ptrdiff_t y, ptrdiff_t rows) {
  return ring + (map * rows + (y + rows) % rows) * o->stride;
}

static inline void add_three(const float *a, const float *b, const float *c, float *out, ptrdiff_t n) {
  for (ptrdiff_t x = 0; x < n; x += LANES) store_lanes(out + x, load_lanes(a + x) + load_lanes(b + x) + load_lanes(c + x));
}

// Takes row y of every map, of which `row_of` holds the values, into the window; zeros where it holds nothing.
static void take_row(const struct window *o, ptrdiff_t y, bool any) {
  for (ptrdiff_t map = 0; map < o->maps; map++) {
    const float *from = o->padded + map * o->stride;
    float *row = in_ring(o->rows, o, map, y, THIRD);
    if (any) {
      add_three(from, from + 1, from + 2, o->threes, whole(o->w + SIDE - THIRD));
      add_three(o->threes, o->threes + THIRD, o->threes + 2 * THIRD, row, whole(o->w));
    } else {
      memset(row, 0, (size_t)o->stride * sizeof *row);
    }
    add_three(in_ring(o->rows, o, map, y - 2, THIRD), in_ring(o->rows, o, map, y - 1, THIRD), row, in_ring(o->sums, o, map, y, LAST),
              whole(o->w));
  }
}

// The sums of a map around each pixel of row y - REACH, after row y was taken.
static void sum_around(const struct window *o, ptrdiff_t map, float *out, ptrdiff_t y) {
  add_three(in_ring(o->sums, o, map, y - 2 * THIRD, LAST), in_ring(o->sums, o, map, y - THIRD, LAST), in_ring(o->sums, o, map, y, LAST),
            out, whole(o->w));
}

enum { PRESSURE, SQUARE, VARIANCE, BENT, KNOWN, MAPS };

// A row of what is summed: the bed's part of what holds the surface up is added to its bending; 0 at unknown pixels.
static void press_row(const struct window *o, const float *restrict smooth, const float *restrict bent, const float *restrict sigma,
                      const float *restrict slopes, float *restrict pressure, float stiffness, float sigmas) {
  const float *restrict ones = row_of(o, KNOWN);
  float *restrict p = row_of(o, PRESSURE), *restrict square = row_of(o, SQUARE), *restrict variance = row_of(o, VARIANCE),
                  *restrict bending = row_of(o, BENT);
  for (ptrdiff_t x = 0; x < o->w; x++) {
    const float one = ones[x] * (bent[x] + stiffness * larger(smooth[x] - sigmas * sigma[x], 0));
    bending[x] = ones[x] * bent[x], variance[x] = ones[x] * slopes[x];
    pressure[x] = p[x] = one, square[x] = one * one;
  }
}

// Pixels that a side of a square around pixel i has within n pixels.
static inline float within(ptrdiff_t i, ptrdiff_t n) {
  return (float)((i + REACH < n ? i + REACH : n - 1) - (i < REACH ? 0 : i - REACH) + 1);
}

// Of row y: means of the known pixels around, from their sums. The variance of a mean Laplacian falls with the square of the area,
// here that of the known pixels.
static void mean_row(const float *restrict sums, ptrdiff_t stride, const float *restrict columns, float rows, float *restrict mean,
                     float *restrict spread, float *restrict variance, float *restrict bent, ptrdiff_t w) {
  const float *restrict p = sums + PRESSURE * stride, *restrict square = sums + SQUARE * stride,
              *restrict slopes = sums + VARIANCE * stride, *restrict bending = sums + BENT * stride, *restrict known = sums + KNOWN * stride;
  for (ptrdiff_t x = 0; x < w; x++) {
    const float each = 1 / larger(known[x], 1), m = p[x] * each, lost = rows * columns[x] * each;
    mean[x] = m, bent[x] = bending[x] * each;
    spread[x] = larger(square[x] * each - m * m, 0);
    variance[x] = slopes[x] * each * lost * lost;
  }
}

// The pressure on each pixel, and means over the known pixels of the square around: of the pressure, how much its values vary
// there, the variance of slopes, and the bending. `smooth`, `bent`: the surface and minus its Laplacian; `slopes`: variance of slopes;
// `known`: NULL where all pixels are. `mean_bent` may be `slopes`, of which a row is read before that of its mean is written.
EXPORT int pressure_means(const float *smooth, const float *bent, const float *sigma, const float *slopes, const bool *known,
                          float *pressure, float *mean, float *spread, float *variance, float *mean_bent, float *work,
                          float stiffness, float sigmas, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  if (n < window_work(MAPS, w) + (MAPS + 1) * stride_of(w)) return WRONG_SIZE;
  struct window o = window_in(work, MAPS, w);
  float *sums = work + window_work(MAPS, w), *restrict ones = row_of(&o, KNOWN), *counts = sums + KNOWN * o.stride;
  float *columns = sums + MAPS * o.stride;
  for (ptrdiff_t x = 0; x < w; x++) ones[x] = 1, columns[x] = within(x, w);
  if (known == NULL) o.maps = KNOWN;
  for (ptrdiff_t y = 0; y < h + REACH; y++) {
    const ptrdiff_t in = y * w, at = (y - REACH) * w;
    if (y < h) {
      for (ptrdiff_t x = 0; known != NULL && x < w; x++) ones[x] = known[in + x] ? 1.0f : 0.0f;
      press_row(&o, smooth + in, bent + in, sigma + in, slopes + in, pressure + in, stiffness, sigmas);
    }
    take_row(&o, y, y < h);
    if (y < REACH) continue;
    const float rows = within(y - REACH, h);
    for (ptrdiff_t map = 0; map < o.maps; map++) sum_around(&o, map, sums + map * o.stride, y);
    for (ptrdiff_t x = 0; known == NULL && x < w; x++) counts[x] = rows * columns[x];
    mean_row(sums, o.stride, columns, rows, mean + at, spread + at, variance + at, mean_bent + at, w);
  }
  return OK;
}

static const float NOISES = 2;  // mean square of noise; the variance of noise alone over a square hardly exceeds it

// The pressure by its local statistics (Lee, IEEE Trans. PAMI 2, 1980): its own value where values vary more around than noise does,
// else their mean. It is kept where it and the mean exceed their own deviation and `factor` times the noise of gel at rest, at known
// pixels; 0 elsewhere. `evidence`: square of the mean over its variance. `mean_gain_at_rest`, ...: variance of the mean's and of the
// pressure's bending for a variance of slopes of 1. `at_rest`, `known`: NULL where all
// are. Returns how many pixels have a pressure.
EXPORT int sure_pressure(const float *restrict pressure, const float *restrict mean, const float *restrict spread,
                         const float *restrict sigma, const float *restrict slopes, const float *restrict noise,
                         const bool *restrict at_rest, const bool *restrict known, float *restrict sure, float *restrict evidence,
                         float stiffness, float factor, float mean_gain_at_rest, float mean_gain_elsewhere, float gain_at_rest,
                         float gain_elsewhere, ptrdiff_t count) {
  enum { CHUNK = 4 * LANES };
  const float many = factor * factor;
  int pixels = 0;
  for (ptrdiff_t start = 0; start < count; start += CHUNK) {
    const ptrdiff_t n = count - start < CHUNK ? count - start : CHUNK;
    int32_t still[CHUNK], counts[CHUNK];
    for (ptrdiff_t k = 0; k < n; k++) still[k] = at_rest == NULL || at_rest[start + k], counts[k] = known == NULL || known[start + k];
    for (ptrdiff_t k = 0; k < n; k++) {
      const ptrdiff_t i = start + k;
      const float of_mean = still[k] ? mean_gain_at_rest : mean_gain_elsewhere, of_one = still[k] ? gain_at_rest : gain_elsewhere;
      const float bed = sigma[i] * stiffness, bed2 = bed * bed, m = larger(mean[i], 0), own = NOISES * gain_at_rest * noise[i];
      const float share = 1 - smaller(own / larger(spread[i], 1e-30f), 1), rest = 1 - share;
      const float q = larger(m + share * (pressure[i] - m), 0);
      const float of_q = share * share * of_one + rest * rest * of_mean,
                  of_noise = many * noise[i] * (share * share * gain_at_rest + rest * rest * mean_gain_at_rest);
      const float variance = slopes[i] * of_mean + bed2;
      counts[k] &= m * m > larger(variance, many * noise[i] * mean_gain_at_rest);
      counts[k] &= q * q > larger(slopes[i] * of_q + bed2, of_noise);
      sure[i] = counts[k] ? q : 0;
      evidence[i] = m * m / larger(variance, 1e-30f);
    }
    for (ptrdiff_t k = 0; k < n; k++) pixels += counts[k];
  }
  return pixels;
}

enum { VALUES, ONES, BOTH };

// The pixels whose pressure is above a share of its mean over those of the square around that have one.
EXPORT int contact_outline(const float *pressure, bool *contact, float *work, float share, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  if (n < window_work(BOTH, w) + BOTH * stride_of(w)) return WRONG_SIZE;
  const struct window o = window_in(work, BOTH, w);
  float *total = work + window_work(BOTH, w), *count = total + o.stride, *restrict ones = row_of(&o, ONES);
  ptrdiff_t last = -SIDE;  // the last row that has any pressure
  memset(contact, 0, (size_t)(h * w));
  for (ptrdiff_t y = 0; y < h + REACH; y++) {
    int32_t any = 0;
    if (y < h) {
      const float *restrict row = pressure + y * w;
      for (ptrdiff_t x = 0; x < w; x++) ones[x] = row[x] > 0 ? 1.0f : 0.0f, any += row[x] > 0;
      memcpy(row_of(&o, VALUES), row, (size_t)w * sizeof *row);
    }
    if (any) last = y;
    take_row(&o, y, any > 0);
    if (y < REACH || y >= last + SIDE) continue;
    const float *restrict row = pressure + (y - REACH) * w;
    bool *restrict map = contact + (y - REACH) * w;
    sum_around(&o, VALUES, total, y), sum_around(&o, ONES, count, y);
    for (ptrdiff_t x = 0; x < w; x++) map[x] = row[x] * count[x] > share * total[x];
  }
  return OK;
}

enum { EDGE = 3, CORNER = 4 };  // distance of pixels that share an edge or a corner (Borgefors, CVGIP 34, 1986)

static inline void take_nearer(uint8_t *map, int32_t *far, ptrdiff_t i, ptrdiff_t from, int32_t step) {
  if (far[from] + step < far[i]) far[i] = far[from] + step, map[i] = map[from];
}

// Gives unknown pixel x of row y what its nearest neighbor has, of those before it (`way` 1) or after it (-1) in the map.
static inline void take_from(uint8_t *map, int32_t *far, ptrdiff_t y, ptrdiff_t x, ptrdiff_t way, ptrdiff_t h, ptrdiff_t w) {
  const ptrdiff_t i = y * w + x, behind = x - way, row = y - way;
  const bool beside = behind >= 0 && behind < w, ahead = x + way >= 0 && x + way < w;
  if (beside) take_nearer(map, far, i, i - way, EDGE);
  if (row < 0 || row >= h) return;
  take_nearer(map, far, i, i - way * w, EDGE);
  if (beside) take_nearer(map, far, i, i - way * w - way, CORNER);
  if (ahead) take_nearer(map, far, i, i - way * w + way, CORNER);
}

// Gives each unknown pixel what the nearest known one has, within `reach` pixels; 0 beyond. `far`: h x w.
static void take_nearest(uint8_t *map, const bool *known, int32_t *far, float reach, ptrdiff_t h, ptrdiff_t w) {
  for (ptrdiff_t i = 0; i < h * w; i++) far[i] = known[i] ? 0 : (int32_t)(CORNER * (h + w));
  for (ptrdiff_t y = 0; y < h; y++)
    if (memchr(known + y * w, 0, (size_t)w) != NULL)
      for (ptrdiff_t x = 0; x < w; x++)
        if (!known[y * w + x]) take_from(map, far, y, x, 1, h, w);
  for (ptrdiff_t y = h - 1; y >= 0; y--)
    if (memchr(known + y * w, 0, (size_t)w) != NULL)
      for (ptrdiff_t x = w - 1; x >= 0; x--)
        if (!known[y * w + x]) take_from(map, far, y, x, -1, h, w);
  for (ptrdiff_t i = 0; i < h * w; i++) map[i] &= (float)far[i] <= EDGE * reach;
}

enum { PRESSED = 1, OPEN = 2 };

// Fills the holes of a map of pressed and open pixels that more pressure holds, in all, than a part of the bed's.
static void fill_holes(uint8_t *map, const float *smooth, const float *bent, struct run *runs, float least, ptrdiff_t h, ptrdiff_t w) {
  const int32_t count = find_runs(map, OPEN, EDGES, runs, h, w);
  for (int32_t k = 0; k < count; k++) runs[k].excess = 0;
  for (int32_t k = 0; k < count; k++) {
    const struct run *one = runs + k;
    const ptrdiff_t row = one->y * w;
    float excess = 0;
    if (one->y == 0 || one->y == h - 1 || one->from == 0 || one->to == w) excess = -INFINITY;  // no hole, but what is around
    for (ptrdiff_t x = one->from; x < one->to; x++) excess += bent[row + x] + least * larger(smooth[row + x], 0);
    runs[first_of(runs, k)].excess += excess;
  }
  for (int32_t k = 0; k < count; k++)
    if (runs[first_of(runs, k)].excess > 0)
      memset(map + runs[k].y * w + runs[k].from, PRESSED, (size_t)(runs[k].to - runs[k].from));
}

// The outline with those gaps, which closing it fills, and those holes that the gel's surface does not sag in as free gel does:
// the pressure there exceeds `least`, for a depth of 1, less than the bed's. Unknown pixels are as the nearest known one, if `reach` pixels
// or less lie between. `known`: NULL where all are.
EXPORT int held_outline(const bool *outline, const bool *closed, const bool *known, const float *mean, const float *smooth,
                        const float *bent, bool *contact, int32_t *work, float stiffness, float share, float reach, ptrdiff_t h,
                        ptrdiff_t w, ptrdiff_t n) {
  const float least = share * stiffness;
  uint8_t *map = (uint8_t *)contact;
  if (n < runs_work(h, w) || n < h * w) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < h * w; i++) map[i] = outline[i] | (closed[i] & (mean[i] > least * larger(smooth[i], 0)));
  if (known != NULL) take_nearest(map, known, work, reach, h, w);
  for (ptrdiff_t i = 0; i < h * w; i++) map[i] = map[i] ? PRESSED : OPEN;
  fill_holes(map, smooth, bent, (struct run *)work, stiffness - least, h, w);
  for (ptrdiff_t i = 0; i < h * w; i++) map[i] &= PRESSED;
  return OK;
}
