// pressure -> contact mask: an outline, regions of it, and what speaks for each; the labels of a mask's regions.
#include "runs.h"

// Rows that are summed along x, in a ring, for sums over a square of 2 reach + 1 pixels.
struct window {
  float *padded, *count_padded, *sums, *counts;
  ptrdiff_t reach, rows, stride;
};

static inline ptrdiff_t whole(ptrdiff_t n) { return (n + LANES - 1) / LANES * LANES; }

static inline ptrdiff_t window_work(ptrdiff_t reach, ptrdiff_t w) {
  return 2 * (whole(w) + 2 * reach) + 2 * (2 * reach + 1) * whole(w);
}

static struct window window_in(float *work, ptrdiff_t reach, ptrdiff_t w) {
  const ptrdiff_t rows = 2 * reach + 1, stride = whole(w), padded = stride + 2 * reach;
  memset(work, 0, (size_t)(2 * padded) * sizeof *work);
  return (struct window){work, work + padded, work + 2 * padded, work + 2 * padded + rows * stride, reach, rows, stride};
}

static inline void sum_along(const float *padded, ptrdiff_t rows, float *out, ptrdiff_t stride) {
  for (ptrdiff_t x = 0; x < stride; x += LANES) {
    lanes total = load_lanes(padded + x);
    for (ptrdiff_t k = 1; k < rows; k++) total += load_lanes(padded + x + k);
    store_lanes(out + x, total);
  }
}

// Takes row y into the window: what was padded of it, summed along x; zeros where it holds nothing.
static void take_sums(const struct window *o, ptrdiff_t y, int32_t any) {
  float *sums = o->sums + y % o->rows * o->stride, *counts = o->counts + y % o->rows * o->stride;
  if (any) {
    sum_along(o->padded, o->rows, sums, o->stride);
    sum_along(o->count_padded, o->rows, counts, o->stride);
  } else {
    memset(sums, 0, (size_t)o->stride * sizeof *sums);
    memset(counts, 0, (size_t)o->stride * sizeof *counts);
  }
}

// Takes row y of a pressure into the window; how many pixels of it are above 0.
static int32_t take_row(const struct window *o, const float *restrict pressure, ptrdiff_t y, ptrdiff_t w) {
  float *restrict ones = o->count_padded + o->reach;
  int32_t any = 0;
  memcpy(o->padded + o->reach, pressure, (size_t)w * sizeof *pressure);
  for (ptrdiff_t x = 0; x < w; x++) {
    ones[x] = pressure[x] > 0 ? 1.0f : 0.0f;
    any += pressure[x] > 0;
  }
  take_sums(o, y, any);
  return any;
}

enum { MAX_REACH = 32 };

// The sum of a ring's rows y - reach to y + reach, as far as they are in the frame.
static inline void sum_rows(const struct window *o, const float *ring, float *out, ptrdiff_t y, ptrdiff_t h) {
  const ptrdiff_t first = y < o->reach ? 0 : y - o->reach, last = y + o->reach < h ? y + o->reach : h - 1;
  const float *rows[2 * MAX_REACH + 1];
  for (ptrdiff_t row = first; row <= last; row++) rows[row - first] = ring + row % o->rows * o->stride;
  for (ptrdiff_t x = 0; x < o->stride; x += LANES) {
    lanes total = load_lanes(rows[0] + x);
    for (ptrdiff_t k = 1; k <= last - first; k++) total += load_lanes(rows[k] + x);
    store_lanes(out + x, total);
  }
}

// Mean pressure, around each pixel of row y, of the pixels above the limit.
static void mean_around(const struct window *o, float *restrict around, float *restrict count, ptrdiff_t y, ptrdiff_t h) {
  sum_rows(o, o->sums, around, y, h);
  sum_rows(o, o->counts, count, y, h);
  for (ptrdiff_t x = 0; x < o->stride; x++) around[x] /= larger(count[x], 1);
}

// The outline of a row: pixels of the coarse pressure that are above a share of the mean around, where that mean is so far above
// its noise that this smoothing draws.
static void draw_row(const float *coarse, const float *pressure, const float *restrict around, const float *restrict noise, float share,
                     float limit, uint8_t *restrict map, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++) {
    const uint8_t drawn = (pressure[x] > share * around[x]) & (coarse[x] > 0);
    map[x] = around[x] * around[x] > limit * noise[x] ? drawn : map[x];
  }
}

static void draw(const float *coarse, const float *pressure, const float *noise, float share, float limit, uint8_t *map, float *work,
                 ptrdiff_t reach, ptrdiff_t h, ptrdiff_t w) {
  const struct window o = window_in(work, reach, w);
  float *around = work + window_work(reach, w), *count = around + whole(w);
  ptrdiff_t last = -1;  // the last row that has any pressure
  for (ptrdiff_t y = 0; y < h + reach; y++) {
    const ptrdiff_t at = (y - reach) * w;
    if (y < h && take_row(&o, pressure + y * w, y, w)) last = y;
    if (y < reach || last < 0 || last < y - 2 * reach) continue;
    mean_around(&o, around, count, y - reach, h);
    draw_row(coarse + at, pressure + at, around, noise + at, share, limit, map + at, w);
  }
}

// `coarse`, `finer`: pressures of two smoothings, 0 where they do not count. `noise`: variance of slopes at rest, of which the square
// of the finer mean pressure exceeds `limit` times where it draws.
EXPORT int contact_outline(const float *coarse, const float *finer, const float *noise, bool *contact, float *work,
                           int64_t reach, float coarse_share, float finer_share, float limit, ptrdiff_t h, ptrdiff_t w,
                           ptrdiff_t n) {
  if (reach < 1 || reach > MAX_REACH || n < window_work(reach, w) + 2 * whole(w)) return WRONG_SIZE;
  uint8_t *map = (uint8_t *)contact;
  memset(map, 0, (size_t)(h * w));
  draw(coarse, coarse, noise, coarse_share, 0, map, work, reach, h, w);
  draw(coarse, finer, noise, finer_share, limit, map, work, reach, h, w);
  return OK;
}

enum { PRESSED = 1, UNKNOWN = 2 };

static inline int32_t side_of(uint8_t pixel) { return pixel & UNKNOWN ? 0 : pixel & PRESSED ? 1 : -1; }

// How many more of the known pixels that a run touches are pressed than are not.
static int32_t pressed_around(const uint8_t *map, const struct run *run, ptrdiff_t h, ptrdiff_t w) {
  const uint8_t *row = map + run->y * w;
  int32_t more = run->from > 0 ? side_of(row[run->from - 1]) : 0;
  if (run->to < w) more += side_of(row[run->to]);
  for (ptrdiff_t x = run->from; x < run->to; x++) {
    if (run->y > 0) more += side_of(row[x - w]);
    if (run->y < h - 1) more += side_of(row[x + w]);
  }
  return more;
}

// Adds to the pressed pixels the regions of unknown ones, such as dots, whose border is pressed for the most part.
EXPORT int add_unknown(const bool *known, const bool *pressed, bool *contact, int32_t *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  struct run *runs = (struct run *)work;
  uint8_t *map = (uint8_t *)contact;
  if (n < runs_work(h, w)) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < h * w; i++) map[i] = (uint8_t)((known[i] & pressed[i]) | !known[i] << 1);  // PRESSED, UNKNOWN
  const int32_t count = find_runs(map, UNKNOWN, EDGES, runs, h, w);
  for (int32_t k = 0; k < count; k++) runs[k].area = 0;
  for (int32_t k = 0; k < count; k++) runs[first_of(runs, k)].area += pressed_around(map, runs + k, h, w);
  for (int32_t k = 0; k < count; k++)
    memset(map + runs[k].y * w + runs[k].from, runs[first_of(runs, k)].area > 0, (size_t)(runs[k].to - runs[k].from));
  return OK;
}

// Labels 1 ... of a mask's regions, in the order of their first pixels, and 0; how many. Where they are more than fit, nothing
// is written.
EXPORT int label_regions(const bool *mask, uint16_t *labels, int32_t *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  struct run *runs = (struct run *)work;
  int regions = 0;
  if (n < runs_work(h, w)) return WRONG_SIZE;
  const int32_t count = find_runs((const uint8_t *)mask, 1, CORNERS, runs, h, w);
  for (int32_t k = 0; k < count; k++) regions += runs[k].parent == k;
  if (regions > UINT16_MAX) return regions;
  memset(labels, 0, (size_t)(h * w) * sizeof *labels);
  regions = 0;
  for (int32_t k = 0; k < count; k++) {
    const int32_t first = first_of(runs, k);
    const int32_t label = first == k ? (runs[k].area = ++regions) : runs[first].area;
    for (ptrdiff_t x = runs[k].from; x < runs[k].to; x++) labels[runs[k].y * w + x] = (uint16_t)label;
  }
  return regions;
}
