// The standard deviation of solved slopes by slope and place, and what presses of balls do not show: walls, the gel around
// contacts, weak light.
#include "../common.h"

struct numbers {
  float from_slope, per_slope, limit, around, dim_from, per_bend, bend_from;
  ptrdiff_t reach;
};

static inline void add_differences(float *restrict sums, const float *restrict here, const float *restrict there,
                                   ptrdiff_t first, ptrdiff_t end) {
  for (ptrdiff_t x = first; x < end; x++) {
    const float p = there[2 * x] - here[2 * x], q = there[2 * x + 1] - here[2 * x + 1];
    sums[x] += p * p + q * q;
  }
}

// Sums of squares of the differences of a row's slopes to those `reach` pixels away on four sides that lie in the frame.
static inline void find_bends(const float *restrict row, float *restrict sums, ptrdiff_t reach, ptrdiff_t y, ptrdiff_t h,
                              ptrdiff_t w) {
  memset(sums, 0, (size_t)w * sizeof *sums);
  add_differences(sums, row, row - 2 * reach, reach, w);
  add_differences(sums, row, row + 2 * reach, 0, w - reach);
  if (y >= reach) add_differences(sums, row, row - 2 * reach * w, 0, w);
  if (y < h - reach) add_differences(sums, row, row + 2 * reach * w, 0, w);
}

static inline void widen_row(const struct numbers *restrict n, const float *restrict row, const bool *restrict contact,
                             const float *restrict gentle, const float *restrict steep, const float *restrict dim,
                             const float *restrict bends, float *restrict sigma, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++) {
    const float square = row[2 * x] * row[2 * x] + row[2 * x + 1] * row[2 * x + 1];
    const float along = clamp((sqrtf(square) - n->from_slope) * n->per_slope, 0, 1);
    const float solved = smaller(sigma[x] * (gentle[x] + along * (steep[x] - gentle[x])), n->limit);
    const float wall = n->per_bend * larger(sqrtf(0.5f * bends[x]) - n->bend_from, 0);
    const float weak = contact[x] ? 1 : square / (square + n->dim_from * n->dim_from);
    const float around = contact[x] ? 0 : n->around * n->around * square;
    sigma[x] = sqrtf(solved * solved + wall * wall + around + weak * dim[x] * dim[x]);
  }
}

EXPORT int widen_sigma(const float *gradients, const bool *contact, const float *gentle, const float *steep,
                       const float *dim, float *work, float *sigma, float from_slope, float per_slope, float limit,
                       float around, float dim_from, float per_bend, float bend_from, int32_t reach, ptrdiff_t h,
                       ptrdiff_t w) {
  const struct numbers n = {from_slope, per_slope, limit, around, dim_from, per_bend, bend_from, reach};
  if (reach < 1 || !(dim_from > 0)) return WRONG_SIZE;
  memset(work, 0, (size_t)w * sizeof *work);
  for (ptrdiff_t y = 0; y < h; y++) {
    const ptrdiff_t at = y * w;
    if (per_bend > 0) find_bends(gradients + 2 * at, work, reach, y, h, w);
    widen_row(&n, gradients + 2 * at, contact + at, gentle + at, steep + at, dim + at, work, sigma + at, w);
  }
  return OK;
}
