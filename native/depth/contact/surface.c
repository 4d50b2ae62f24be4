// depth -> how its surface bends, and how noisy it is.
#include "../../image/background/blurred_change.h"
#include "../../select.h"
#include "steps.h"

static inline ptrdiff_t within(ptrdiff_t i, ptrdiff_t n) { return i < 0 ? 0 : i < n ? i : n - 1; }

// A row of the depth blurred along x, its outermost pixels repeated.
static void blur_along(const float *depth, float *padded, const float *taps, ptrdiff_t radius, float *out, ptrdiff_t w) {
  struct taken from;
  for (ptrdiff_t x = 0; x < radius; x++) padded[x] = depth[0], padded[radius + w + x] = depth[w - 1];
  memcpy(padded + radius, depth, (size_t)w * sizeof *depth);
  for (ptrdiff_t k = 0; k <= radius; k++) from.before[k] = padded + radius - k, from.after[k] = padded + radius + k;
  weighted_sum(&from, taps, radius, out, w);
}

static inline float bending(const float *up, const float *row, const float *down, ptrdiff_t left, ptrdiff_t at,
                            ptrdiff_t right, float along_x, float along_y) {
  const float z = row[at];
  return along_x * ((z - row[left]) + (z - row[right])) + along_y * ((z - up[at]) + (z - down[at]));
}

// Minus the Laplacian of a row; in the margin that of the next pixel inside.
static void bend_row(const float *smooth, float *restrict bent, ptrdiff_t y, float along_x, float along_y, ptrdiff_t margin,
                     ptrdiff_t h, ptrdiff_t w) {
  const float *restrict up = smooth + mirrored(y - 1, h) * w, *restrict row = smooth + y * w,
              *restrict down = smooth + mirrored(y + 1, h) * w;
  for (ptrdiff_t x = 1; x < w - 1; x++) bent[x] = bending(up, row, down, x - 1, x, x + 1, along_x, along_y);
  bent[0] = bending(up, row, down, mirrored(-1, w), 0, mirrored(1, w), along_x, along_y);
  bent[w - 1] = bending(up, row, down, mirrored(w - 2, w), w - 1, mirrored(w, w), along_x, along_y);
  for (ptrdiff_t x = 0; x < margin; x++) bent[x] = bent[margin], bent[w - 1 - x] = bent[w - 1 - margin];
}

// Depth blurred with symmetric `taps`, the middle first, and minus its Laplacian; `along_x`, `along_y`: 1/pitch^2.
EXPORT int bent_surface(const float *depth, const float *taps, float *smooth, float *bent, float *work, float along_x,
                        float along_y, int64_t margin, ptrdiff_t h, ptrdiff_t w, ptrdiff_t t, ptrdiff_t n) {
  const ptrdiff_t radius = t - 1, rows = 2 * radius + 1, stride = whole_lanes(w);
  float *ring = work + w + 2 * radius + LANES;
  struct taken from;
  ptrdiff_t filled = 0;
  if (radius > MAX_RADIUS || n < w + 2 * radius + LANES + rows * stride) return WRONG_SIZE;
  if (margin < 0 || 2 * margin >= (h < w ? h : w)) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y++) {
    for (; filled < h && filled <= y + radius; filled++)
      blur_along(depth + filled * w, work, taps, radius, ring + filled % rows * stride, w);
    for (ptrdiff_t k = 0; k <= radius; k++) {
      from.before[k] = ring + within(y - k, h) % rows * stride;
      from.after[k] = ring + within(y + k, h) % rows * stride;
    }
    weighted_sum(&from, taps, radius, smooth + y * w, w);
    if (y > margin && y <= h - 1 - margin) bend_row(smooth, bent + (y - 1) * w, y - 1, along_x, along_y, margin, h, w);
  }
  bend_row(smooth, bent + (h - 1 - margin) * w, h - 1 - margin, along_x, along_y, margin, h, w);
  for (ptrdiff_t y = 0; y < margin; y++) {
    memcpy(bent + y * w, bent + margin * w, (size_t)w * sizeof *bent);
    memcpy(bent + (h - 1 - y) * w, bent + (h - 1 - margin) * w, (size_t)w * sizeof *bent);
  }
  return OK;
}

// The magnitude, over the root of its place's unit, that a share of every `step`-th value is below: of those chosen, or of all
// where `chosen` is NULL; 0 where there are none.
EXPORT int magnitude_of_share(const float *values, const float *units, const bool *chosen, float *work, float *magnitude,
                              int64_t step, double share, ptrdiff_t count, ptrdiff_t n) {
  ptrdiff_t taken = 0;
  if (step < 1 || count < 1 || n < 2 * ((count + step - 1) / step)) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < count; i += step) {
    work[taken] = values[i] * values[i] / units[i];
    taken += chosen == NULL || chosen[i];
  }
  *magnitude = taken ? sqrtf(kth_smallest(work, taken, (ptrdiff_t)(share * (double)(taken - 1)), (uint32_t *)(work + taken))) : 0;
  return OK;
}

static const float MOST_VARIANCE = 0.3f;  // (mm/mm)^2; a slope of such variance is not known at all

// Variance of slopes, from their deviation as they were read where the gel is at rest, elsewhere of the solved depth's slopes.
EXPORT int slope_variance(const float *restrict read, const float *restrict solved, const bool *restrict at_rest,
                          float *restrict variance, ptrdiff_t count) {
  for (ptrdiff_t i = 0; i < count; i++) {
    const float r = read[i], s = solved[i], deviation = at_rest[i] ? r : s;
    variance[i] = smaller(deviation * deviation, MOST_VARIANCE);
  }
  return OK;
}

// How much larger the variance of the depths below 0 is than their deviations say: of every `step`-th one, surer ones count for
// more. 0 where it is not larger.
EXPORT int variance_below(const float *depth, const float *sigma, double *excess, int64_t step, ptrdiff_t count) {
  double total = 0, weights = 0;
  if (step < 1) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < count; i += step) {
    if (!(depth[i] < 0)) continue;
    const double z = depth[i], s = larger(sigma[i], 1e-6f);
    total += (z - s) * (z + s) / (s * s), weights += 1 / (s * s);
  }
  *excess = total > 0 ? total / weights : 0;
  return OK;
}
