// Slopes of a depth map, and how far slopes are from those of a surface.
#include "../common.h"

// Difference per pixel at the first of n values, of second order where there are three.
static inline float one_sided(const float *z, ptrdiff_t step, ptrdiff_t n) {
  if (n < 2) return 0;
  return n == 2 ? z[step] - z[0] : 2 * (z[step] - z[0]) - 0.5f * (z[2 * step] - z[0]);
}

static inline void differences_along_row(const float *restrict z, float per_px, float *restrict gradients, ptrdiff_t w) {
  const float half = 0.5f * per_px;
  for (ptrdiff_t x = 1; x < w - 1; x++) gradients[2 * x] = half * (z[x + 1] - z[x - 1]);
  gradients[0] = per_px * one_sided(z, 1, w);
  gradients[2 * (w - 1)] = -per_px * one_sided(z + w - 1, -1, w);
}

static inline void differences_down(const float *restrict above, const float *restrict below, float per_px,
                                    float *restrict gradients, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++) gradients[2 * x + 1] = per_px * (below[x] - above[x]);
}

// Central differences, one-sided at the border. `per_x`, `per_y`: pixels per unit of depth, 1 / mm_per_px.
EXPORT int slopes_of_depth(const float *depth, float *gradients, float per_x, float per_y, ptrdiff_t h, ptrdiff_t w) {
  for (ptrdiff_t y = 0; y < h; y++) {
    differences_along_row(depth + y * w, per_x, gradients + 2 * y * w, w);
    if (y > 0 && y < h - 1)
      differences_down(depth + (y - 1) * w, depth + (y + 1) * w, 0.5f * per_y, gradients + 2 * y * w, w);
  }
  float *first = gradients, *last = gradients + 2 * (h - 1) * w;
  for (ptrdiff_t x = 0; x < w; x++) {
    first[2 * x + 1] = per_y * one_sided(depth + x, w, h);
    last[2 * x + 1] = -per_y * one_sided(depth + (h - 1) * w + x, -w, h);
  }
  return OK;
}

// Squares of dp/dy - dq/dx of the known pixels of a row, by central differences, and how many they are.
static inline void curl_of_row(const float *restrict above, const float *restrict here, const float *restrict below,
                               const bool *restrict known, ptrdiff_t w, double *restrict total, ptrdiff_t *count) {
  float lanes[LANES] = {0};
  int32_t counted = 0;
  for (ptrdiff_t start = 1; start < w - 1; start += LANES) {
    const ptrdiff_t n = w - 1 - start < LANES ? w - 1 - start : LANES;
    for (ptrdiff_t k = 0; k < n; k++) {
      const ptrdiff_t x = start + k;
      const int32_t seen = known[x];
      const float curl = (below[2 * x] - above[2 * x]) - (here[2 * x + 3] - here[2 * x - 1]);
      lanes[k] += (float)seen * curl * curl;
      counted += seen;
    }
  }
  *total += 0.25f * lanes_total(lanes);
  *count += counted;
}

// Their sum and number over frames: result (2).
EXPORT int curl_squares(const float *gradients, const bool *known, double *result, ptrdiff_t n, ptrdiff_t h,
                        ptrdiff_t w) {
  double total = 0;
  ptrdiff_t count = 0;
  for (ptrdiff_t frame = 0; frame < n; frame++)
    for (ptrdiff_t y = 1; y < h - 1; y++) {
      const float *here = gradients + 2 * w * (frame * h + y);
      curl_of_row(here - 2 * w, here, here + 2 * w, known + w * (frame * h + y), w, &total, &count);
    }
  result[0] = total;
  result[1] = (double)count;
  return OK;
}
