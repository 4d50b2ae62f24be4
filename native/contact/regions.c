// pressure -> contact mask: where it is high enough, in regions that start for sure; and the labels of a mask's regions.
#include "runs.h"

enum { ABOVE = 1, HALF = 2, FLAT = 4, CORE = 8 };  // what a pixel of the map is, until it is contact or not
enum { ERODED = 2 };                               // pixels that a flat face is taken to be smaller by

struct rules {
  float limit, least_of_bed, flat, of_flat, half, finer_half, finer_limit;
};

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

// Marks what is above the limit in a row, and takes the row into the window. `noise`: of each place, times the limit.
static void take_row(const struct window *o, const struct rules *rule, const float *restrict pressure,
                     const float *restrict bed, const float *restrict noise, uint8_t *restrict map, ptrdiff_t y,
                     ptrdiff_t w) {
  float *restrict values = o->padded + o->reach, *restrict ones = o->count_padded + o->reach;
  int32_t any = 0;
  for (ptrdiff_t x = 0; x < w; x++) {
    const int32_t above = pressure[x] > larger(rule->limit * noise[x], rule->least_of_bed * bed[x]);
    values[x] = above ? pressure[x] : 0;
    ones[x] = above ? 1.0f : 0.0f;
    any += above;
  }
  for (ptrdiff_t x = 0; x < w; x++) map[x] = ones[x] > 0 ? ABOVE : 0;
  take_sums(o, y, any);
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

static int32_t judge_row(const struct rules *rule, const float *restrict pressure, const float *restrict bed,
                         const float *restrict around, uint8_t *restrict map, ptrdiff_t w) {
  int32_t flat_faces = 0;
  for (ptrdiff_t x = 0; x < w; x++) {
    const int32_t above = map[x], half = pressure[x] > rule->half * around[x];
    const int32_t flat = (pressure[x] > rule->of_flat * bed[x]) & (bed[x] > rule->flat * around[x]);
    map[x] = (uint8_t)(above ? ABOVE | (half ? HALF : 0) | (flat ? FLAT : 0) : 0);
    flat_faces += above & flat;
  }
  return flat_faces;
}

// Marks in a row of the map the pixels whose whole neighborhood is flat, as far as it is in the frame.
static void mark_core(uint8_t *map, ptrdiff_t y, uint8_t *column, ptrdiff_t h, ptrdiff_t w) {
  const ptrdiff_t first = y < ERODED ? 0 : y - ERODED, last = y + ERODED < h ? y + ERODED : h - 1;
  memset(column, FLAT, (size_t)(w + 2 * ERODED));
  for (ptrdiff_t row = first; row <= last; row++)
    for (ptrdiff_t x = 0; x < w; x++) column[x + ERODED] &= map[row * w + x];
  for (ptrdiff_t x = 0; x < w; x++) {
    uint8_t all = FLAT;
    for (ptrdiff_t k = 0; k <= 2 * ERODED; k++) all &= column[x + k];
    map[y * w + x] |= all ? CORE : 0;
  }
}

// Takes a row of the finer pressure into the window, where the map has contact; whether it has any.
static int32_t take_finer(const struct window *o, const struct rules *rule, const float *restrict finer,
                          const float *restrict bed, const uint8_t *restrict map, ptrdiff_t y, ptrdiff_t w) {
  float *restrict values = o->padded + o->reach, *restrict ones = o->count_padded + o->reach;
  int32_t any = 0;
  for (ptrdiff_t x = 0; x < w; x++) {
    const float pressure = finer[x] + bed[x];
    const int32_t taken = ((map[x] & (HALF | CORE)) != 0) & (pressure > rule->least_of_bed * bed[x]);
    values[x] = taken ? pressure : 0;
    ones[x] = taken ? 1.0f : 0.0f;
    any += taken;
  }
  take_sums(o, y, any);
  return any;
}

// A wide smoothing widens what is narrow. Of the map's contact goes out what by a finer smoothing has less than its share of the
// mean pressure around, where that is above the finer one's limit: below, noise would tear holes. The middle of a flat face
// stays. `finer`: minus the Laplacian.
static void narrow(const struct window *o, const struct rules *rule, const float *finer, const float *bed, const float *noise,
                   uint8_t *map, float *around, ptrdiff_t h, ptrdiff_t w) {
  ptrdiff_t last = -1;  // the last row that counts in any window
  for (ptrdiff_t y = 0; y < h + o->reach; y++) {
    const ptrdiff_t at = (y - o->reach) * w;
    if (y < h && take_finer(o, rule, finer + y * w, bed + y * w, map + y * w, y, w)) last = y;
    if (y < o->reach || last < 0 || last < y - 2 * o->reach) continue;
    mean_around(o, around, around + whole(w), y - o->reach, h);
    for (ptrdiff_t x = 0; x < w; x++) {
      const int32_t below = finer[at + x] + bed[at + x] <= rule->finer_half * around[x];
      const int32_t above = around[x] > rule->finer_limit * noise[at + x];
      map[at + x] &= (below & above) ? (uint8_t)~HALF : 0xff;
    }
  }
}

static void count_seeds(struct run *runs, int32_t count, const float *pressure, const float *noise, float seed,
                        ptrdiff_t w) {
  for (int32_t k = 0; k < count; k++) {
    const int32_t first = first_of(runs, k);
    int32_t seeds = 0;
    const ptrdiff_t row = runs[k].y * w;
    for (ptrdiff_t at = row + runs[k].from; at < row + runs[k].to; at++) seeds += pressure[at] > seed * noise[at];
    if (first != k) runs[first].area += runs[k].area;
    runs[first].seeds += seeds;
  }
}

// `noise`: of each place, in units of which the limits are. `finer`: minus the Laplacian by the next finer smoothing, where the
// pressure is of a wide one, or NULL.
EXPORT int contact_regions(const float *pressure, const float *bed, const float *noise, const float *finer, bool *contact,
                           float *work, int64_t reach, float limit, float least_of_bed, float flat, float of_flat, float half,
                           float finer_half, float finer_limit, float seed, float min_px, ptrdiff_t h,
                           ptrdiff_t w, ptrdiff_t n) {
  const struct rules rule = {limit, least_of_bed, flat, of_flat, half, finer_half, finer_limit};
  if (reach < 1 || reach > MAX_REACH || n < window_work(reach, w) + 2 * whole(w) + runs_work(h, w)) return WRONG_SIZE;
  const struct window o = window_in(work, reach, w);
  float *around = work + window_work(reach, w);
  struct run *runs = (struct run *)(around + 2 * whole(w));
  uint8_t *map = (uint8_t *)contact;
  int32_t flat_faces = 0;
  for (ptrdiff_t y = 0; y < h + reach; y++) {
    const ptrdiff_t at = (y - reach) * w;
    if (y < h) take_row(&o, &rule, pressure + y * w, bed + y * w, noise + y * w, map + y * w, y, w);
    if (y < reach || memchr(map + at, ABOVE, (size_t)w) == NULL) continue;
    mean_around(&o, around, around + whole(w), y - reach, h);
    flat_faces += judge_row(&rule, pressure + at, bed + at, around, map + at, w);
  }
  for (ptrdiff_t y = 0; flat_faces > 0 && y < h; y++) mark_core(map, y, (uint8_t *)work, h, w);
  if (finer != NULL) narrow(&o, &rule, finer, bed, noise, map, around, h, w);
  const int32_t count = find_runs(map, HALF | CORE, CORNERS, runs, h, w);
  count_seeds(runs, count, pressure, noise, seed, w);
  memset(contact, 0, (size_t)(h * w));
  for (int32_t k = 0; k < count; k++) {
    const struct run *first = runs + first_of(runs, k);
    if ((float)first->area >= min_px && first->seeds > 0)
      memset(contact + runs[k].y * w + runs[k].from, 1, (size_t)(runs[k].to - runs[k].from));
  }
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
