// Standard deviation of the solved slopes, from that of the slopes that were read, each within a limit.
#include "../common.h"

// Besides its own reading a slope is known by the two loops of four edges that it closes, each through three others.
static const float LOOPS = 2.0f / 3;

static inline float variance(float sigma, float limit) {
  const float within = smaller(sigma, limit);
  return within * within;
}

// Sum of the variances of each pixel's neighbours in three rows; beyond the border the outermost pixel repeats.
static inline void sum_of_three_rows(const float *restrict above, const float *restrict here,
                                     const float *restrict below, float limit, float *restrict column, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++)
    column[x + 1] = variance(above[x], limit) + variance(here[x], limit) + variance(below[x], limit);
  column[0] = column[1];
  column[w + 1] = column[w];
}

static inline void solved_row(const float *restrict sigma, const float *restrict column, float factor, float limit,
                              float *restrict solved, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++) {
    const float own = variance(sigma[x], limit);
    const float others = (column[x] + column[x + 1] + column[x + 2] - own) * 0.125f;
    solved[x] = factor * sqrtf((1 + LOOPS) * own * others / (others + LOOPS * own));
  }
}

EXPORT int solved_sigma(const float *sigma, float *work, float *solved, float factor, float limit, ptrdiff_t h,
                        ptrdiff_t w, ptrdiff_t n) {
  if (n < w + 2) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y++) {
    const float *here = sigma + y * w, *above = y > 0 ? here - w : here, *below = y < h - 1 ? here + w : here;
    sum_of_three_rows(above, here, below, limit, work, w);
    solved_row(here, work, factor, limit, solved + y * w, w);
  }
  return OK;
}
