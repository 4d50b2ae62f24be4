// Causes that raise the standard deviation of a frame's slopes, in one pass, and the confidence that follows.
#include "../../common.h"

enum { PIECE = 64 };  // pixels of a row at a time

struct causes {
  float outlier, unseen, full_confidence_sigma, added, per_bend, bend_from, unknown, least;
  int32_t reach;
};

struct lines {
  float bend[2 * PIECE], wall[PIECE], outlier[PIECE], variance[PIECE];
};

static inline float square_of(float x) { return x * x; }

static inline void add_squares(float *restrict sums, const float *restrict here, const float *restrict there, int first, int end) {
  for (int i = first; i < end; i++) sums[i] += square_of(there[i] - here[i]);
}

static inline void all_squares(float *restrict sums, const float *restrict at, ptrdiff_t across, ptrdiff_t down) {
  for (ptrdiff_t i = 0; i < 2 * PIECE; i++)
    sums[i] = ((square_of(at[i - across] - at[i]) + square_of(at[i + across] - at[i])) + square_of(at[i - down] - at[i])) + square_of(at[i + down] - at[i]);
}

// Squares of the differences of the slopes (p, q) from pixel x of row y on to those `reach` pixels away on four sides.
static inline void find_bend(const struct causes *c, struct lines *restrict l, const float *restrict gradients, ptrdiff_t x,
                             ptrdiff_t y, ptrdiff_t w, ptrdiff_t h, int n) {
  const ptrdiff_t reach = c->reach, left = reach - x, right = w - reach - x;
  const float *at = gradients + 2 * (y * w + x);
  if (n == PIECE && left <= 0 && right >= n && y >= reach && y < h - reach) {  // nearly everywhere
    all_squares(l->bend, at, 2 * reach, 2 * reach * w);
    return;
  }
  memset(l->bend, 0, sizeof l->bend);
  if (left < n) add_squares(l->bend, at, at - 2 * reach, 2 * (left > 0 ? (int)left : 0), 2 * n);
  if (right > 0) add_squares(l->bend, at, at + 2 * reach, 0, 2 * (right < n ? (int)right : n));
  if (y >= reach) add_squares(l->bend, at, at - 2 * reach * w, 0, 2 * n);
  if (y < h - reach) add_squares(l->bend, at, at + 2 * reach * w, 0, 2 * n);
}

// Whether some value is at or over a limit; nothing else has to be computed.
static inline bool any_from(const float *restrict values, float limit, int n) {
  int count = 0;
  for (int k = 0; k < n; k++) count += values[k] >= limit;
  return count > 0;
}

// Variance of slopes that differ by more than `bend_from` from those around them.
static inline void variance_of_walls(const struct causes *c, struct lines *restrict l) {
  for (int k = 0; k < PIECE; k++) l->variance[k] = 0.5f * (l->bend[2 * k] + l->bend[2 * k + 1]);
  memset(l->wall, 0, sizeof l->wall);
  if (!any_from(l->variance, square_of(c->bend_from), PIECE)) return;
  for (int k = 0; k < PIECE; k++)
    l->wall[k] = square_of(c->per_bend * larger(sqrtf(l->variance[k]) - c->bend_from, 0));
}

// Variance of slopes whose color leaves a residual of more than half of `outlier`, in units of its covariance, to which that of
// a wall's slopes is added: from `outlier` on nothing is known of the slope. Pixels that say nothing anyway have no outlier:
// what clips, is hidden or is not lit is no color.
static inline void variance_of_outliers(const struct causes *c, struct lines *restrict l, const float *restrict residual,
                                        const float *restrict of_step, const bool *restrict unseen_at, int n) {
  memset(l->outlier, 0, sizeof l->outlier);
  if (residual == NULL || !any_from(residual, 0.5f * c->outlier, n)) return;
  for (int k = 0; k < n; k++) {
    const float share = residual[k] * of_step[k] / ((of_step[k] + l->wall[k]) * c->outlier);
    l->outlier[k] = smaller(square_of(c->unknown * larger(2 * share - 1, 0)), square_of(c->unseen));
  }
  if (unseen_at != NULL)
    for (int k = 0; k < n; k++) l->outlier[k] = unseen_at[k] ? 0 : l->outlier[k];
}

// A wall alone costs a slope no more of its confidence than leaves `least`.
static inline void finish(const struct causes *c, const struct lines *restrict l, const float *restrict gain,
                          float *restrict sigma, float *restrict confidence, int n) {
  const float full = c->full_confidence_sigma * c->full_confidence_sigma, most_of_wall = full / c->least;
  for (int k = 0; k < n; k++) {
    const float noise = c->added * gain[k], others = sigma[k] * sigma[k] + l->outlier[k] + noise * noise;
    sigma[k] = sqrtf(others + l->wall[k]);
    confidence[k] = smaller(full / (others + smaller(l->wall[k], most_of_wall)), 1);
  }
}

static inline void write_roots(float *restrict map, const float *restrict variance, int n) {
  if (map != NULL)
    for (int k = 0; k < n; k++) map[k] = sqrtf(variance[k]);
}

// `residual` and `of_step`, the slopes' variance: of the forward response's step, or NULL. `walls` and `outliers` get what
// either adds, where they are asked for.
EXPORT int raise_sigma(const float *gradients, const float *residual, const float *of_step, const bool *unseen_at,
                       const float *gain, float *sigma, float *confidence, float *walls, float *outliers, float outlier,
                       float unseen, float full_confidence_sigma, float added, float per_bend, float bend_from, float unknown, float least,
                       int32_t reach, ptrdiff_t h, ptrdiff_t w) {
  const struct causes c = {outlier, unseen, full_confidence_sigma, added, per_bend, bend_from, unknown, least, reach};
  const float square = unseen * unseen;
  if (reach < 1 || !(outlier > 0) || (residual != NULL) != (of_step != NULL)) return WRONG_SIZE;
  struct lines l = {0};
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x += PIECE) {
      const ptrdiff_t at = y * w + x;
      const int n = w - x < PIECE ? (int)(w - x) : PIECE;
      find_bend(&c, &l, gradients, x, y, w, h, n);
      variance_of_walls(&c, &l);
      variance_of_outliers(&c, &l, residual == NULL ? NULL : residual + at, of_step == NULL ? NULL : of_step + at,
                           unseen_at == NULL ? NULL : unseen_at + at, n);
      write_roots(walls == NULL ? NULL : walls + at, l.wall, n);
      write_roots(outliers == NULL ? NULL : outliers + at, l.outlier, n);
      if (unseen_at != NULL)  // where no outlier is
        for (int k = 0; k < n; k++) l.outlier[k] += unseen_at[at + k] ? square : 0;
      finish(&c, &l, gain + at, sigma + at, confidence + at, n);
    }
  return OK;
}
