#include "../../common.h"

// Sum of squares and number of the edges that count.
struct squares {
  double sum;
  ptrdiff_t count;
};

enum { BLOCK = 256 };

// Edges from the pixels of a row to those `step` on, to the right or in the next row: recovered minus given slope.
static void add_edges(const float *restrict z, const float *restrict g, const bool *restrict known, ptrdiff_t step, float per_px,
                      ptrdiff_t n, struct squares *total) {
  float residual[BLOCK];
  for (ptrdiff_t start = 0; start < n; start += BLOCK) {
    const ptrdiff_t m = n - start < BLOCK ? n - start : BLOCK;
    int32_t count = 0;
    for (ptrdiff_t k = 0, j = start; k < m; k++, j++) {
      const int32_t counts = known[j] & known[j + step];
      residual[k] = (float)counts * ((z[j + step] - z[j]) * per_px - 0.5f * (g[2 * j] + g[2 * (j + step)]));
      count += counts;
    }
    total->sum += dot(residual, residual, m);
    total->count += count;
  }
}

// Over the edges between known pixels of n frames. `per_x`, `per_y`: 1 / mm_per_px. Result: sum of squares, number.
EXPORT int residual_squares(const float *depth, const float *gradients, const bool *known, float per_x, float per_y,
                            double *result, ptrdiff_t n, ptrdiff_t h, ptrdiff_t w) {
  struct squares total = {0};
  for (ptrdiff_t k = 0; k < n * h; k++) {
    const float *z = depth + k * w, *g = gradients + 2 * k * w;
    const bool *seen = known + k * w;
    add_edges(z, g, seen, 1, per_x, w - 1, &total);
    if (k % h < h - 1) add_edges(z, g + 1, seen, w, per_y, w, &total);
  }
  result[0] = total.sum, result[1] = (double)total.count;
  return OK;
}
