// Standard deviation of the solved slopes: from that of the slopes that were read, by slope and place, and with what presses of
// balls do not show: blurred walls.
#include "../../common.h"

// Besides its own reading a slope is known by the two loops of four edges that it closes, each through three others.
static const float LOOPS = 2.0f / 3;
// Variance of a second difference over that of each of five slopes that are off independently: so much of it is no wall's.
static const float OF_NOISE = 20;

struct numbers {
  float curvature, unlimited, from_slope, per_slope, limit;
};

struct maps {
  const float *sigma, *gentle, *steep, *gradients;
};

static inline float square_of(float x) { return x * x; }

// Sum of the variances of each pixel's neighbors in three rows; beyond the border the outermost pixel repeats.
static inline void sum_of_three_rows(const float *restrict above, const float *restrict here,
                                     const float *restrict below, float limit, float *restrict column, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++)
    column[x + 1] = square_of(smaller(above[x], limit)) + square_of(smaller(here[x], limit)) + square_of(smaller(below[x], limit));
  column[0] = column[1];
  column[w + 1] = column[w];
}

// Second differences of the slopes (p, q) of a row to those on four sides.
static inline void compare(const float *restrict row, ptrdiff_t left, ptrdiff_t right, const float *restrict above,
                           const float *restrict below, float *restrict second, ptrdiff_t first, ptrdiff_t end) {
  for (ptrdiff_t i = first; i < end; i++) {
    const float here = row[i];
    second[i] = ((row[i - left] - here) + (row[i + right] - here)) + ((above[i] - here) + (below[i] - here));
  }
}

// Nothing differs where the frame ends before the other pixel.
static inline void compare_row(const float *row, ptrdiff_t reach, ptrdiff_t y, float *restrict second, ptrdiff_t h, ptrdiff_t w) {
  const float *above = y >= reach ? row - 2 * reach * w : row, *below = y < h - reach ? row + 2 * reach * w : row;
  const ptrdiff_t inner = reach < w ? reach : w, outer = w - inner, side = 2 * reach;
  const ptrdiff_t a = 2 * (inner < outer ? inner : outer), b = 2 * (inner < outer ? outer : inner);
  const ptrdiff_t both = inner <= outer ? side : 0;
  compare(row, 0, side, above, below, second, 0, a);
  compare(row, both, both, above, below, second, a, b);
  compare(row, side, 0, above, below, second, b, 2 * w);
}

static inline void solve_row(const struct numbers *restrict n, const struct maps *restrict m, ptrdiff_t at,
                             const float *restrict column, const float *restrict second, float *restrict solved,
                             float *restrict wall, ptrdiff_t w) {
  const float *restrict sigma = m->sigma + at, *restrict row = m->gradients + 2 * at;
  const float *restrict gentle = m->gentle + at, *restrict steep = m->steep + at;
  const float curvature = square_of(n->curvature);
  for (ptrdiff_t x = 0; x < w; x++) {
    const float own = square_of(smaller(sigma[x], n->unlimited));
    const float others = (column[x] + column[x + 1] + column[x + 2] - own) * 0.125f;
    const float read = sqrtf((1 + LOOPS) * own * others / (others + LOOPS * own));
    const float along = clamp((sqrtf(square_of(row[2 * x]) + square_of(row[2 * x + 1])) - n->from_slope) * n->per_slope, 0, 1);
    const float known = smaller(read * (gentle[x] + along * (steep[x] - gentle[x])), n->limit);
    const float bend = square_of(second[2 * x]) + square_of(second[2 * x + 1]);
    const float blurred = curvature * larger(bend - OF_NOISE * known * known, 0);
    wall[x] = sqrtf(blurred);
    solved[x] = sqrtf(known * known + blurred);
  }
}

EXPORT int solved_sigma(const float *sigma, const float *gradients, const float *gentle, const float *steep, float *work,
                        float *solved, float *wall, float curvature, float unlimited, float from_slope, float per_slope,
                        float limit, int32_t reach, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  if (reach < 1 || n < 3 * w + 2) return WRONG_SIZE;
  const struct numbers values = {curvature, unlimited, from_slope, per_slope, limit};
  const struct maps m = {sigma, gentle, steep, gradients};
  float *column = work, *second = work + w + 2;
  memset(second, 0, (size_t)(2 * w) * sizeof *second);
  for (ptrdiff_t y = 0; y < h; y++) {
    const ptrdiff_t at = y * w;
    const float *here = sigma + at, *above = y > 0 ? here - w : here, *below = y < h - 1 ? here + w : here;
    sum_of_three_rows(above, here, below, unlimited, column, w);
    if (curvature > 0) compare_row(gradients + 2 * at, reach, y, second, h, w);
    solve_row(&values, &m, at, column, second, solved + at, wall + at, w);
  }
  return OK;
}
