// The variance of each slope of a frame: the sum of named rows, in one pass.
#include "../../common.h"
#include "outlier.h"

enum { PIECE = 64 };  // pixels of a row at a time

struct budget {
  float per_step, per_size, solved, unknown, outlier, unseen, full, noise, per_bend, bend_from, spread, shown,
      per_excess, doubted, steepest, carried, ball_x, ball_y, ball_radius, of_ball;
  int32_t reach;
};

struct lines {
  float bend[2 * PIECE], wall[PIECE], outlier[PIECE], slope[PIECE], read[PIECE];
};

static inline void add_squares(float *restrict sums, const float *restrict here, const float *restrict there, int first, int end) {
  for (int i = first; i < end; i++) sums[i] += square_of(there[i] - here[i]);
}

static inline void all_squares(float *restrict sums, const float *restrict at, ptrdiff_t across, ptrdiff_t down) {
  for (ptrdiff_t i = 0; i < 2 * PIECE; i++)
    sums[i] = ((square_of(at[i - across] - at[i]) + square_of(at[i + across] - at[i])) + square_of(at[i - down] - at[i])) + square_of(at[i + down] - at[i]);
}

// Squares of the differences of the slopes (p, q) from pixel x of row y on to those `reach` pixels away on four sides.
static inline void find_bend(const struct budget *c, struct lines *restrict l, const float *restrict gradients, ptrdiff_t x,
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

// Slopes that differ by more than `bend_from` from those around them are blurred.
static inline void variance_of_walls(const struct budget *c, struct lines *restrict l) {
  float square[PIECE];
  for (int k = 0; k < PIECE; k++) square[k] = 0.5f * (l->bend[2 * k] + l->bend[2 * k + 1]);
  memset(l->wall, 0, sizeof l->wall);
  if (!any_from(square, square_of(c->bend_from), PIECE)) return;
  for (int k = 0; k < PIECE; k++) l->wall[k] = square_of(c->per_bend * larger(sqrtf(square[k]) - c->bend_from, 0));
}

// At rest by place; elsewhere by the step and the slope's size. What a color model's own deviation exceeds it by is an outlier's.
static inline void variance_by_law(const struct budget *restrict c, struct lines *restrict l, const float *restrict slopes,
                                   const bool *restrict at_rest, const float *restrict rest, const float *restrict of_step,
                                   const float *restrict of_model, int n) {
  for (int k = 0; k < n; k++) l->slope[k] = square_of(slopes[2 * k]) + square_of(slopes[2 * k + 1]);
  for (int k = 0; k < n; k++) l->read[k] = c->per_step + c->per_size * l->slope[k];
  if (of_step != NULL)
    for (int k = 0; k < n; k++) l->read[k] *= of_step[k];
  for (int k = 0; k < n; k++) l->read[k] = at_rest[k] ? rest[k] : l->read[k];
  if (of_model != NULL)
    for (int k = 0; k < n; k++) l->outlier[k] += larger(square_of(of_model[k]) - l->read[k], 0);
}

// Adds the rows that a frame brings. What clips, is hidden or is not lit is no color, so it has no outlier.
static inline void add_rows(const struct budget *restrict c, struct lines *restrict l, const float *restrict gain,
                            const float *restrict light, const bool *restrict unseen, int n) {
  const float nothing = square_of(c->unseen);
  for (int k = 0; k < n; k++) l->outlier[k] = smaller(l->outlier[k], nothing);
  if (unseen != NULL)
    for (int k = 0; k < n; k++) l->outlier[k] = unseen[k] ? 0 : l->outlier[k];
  for (int k = 0; k < n; k++) l->read[k] += square_of(c->noise * gain[k]) + l->wall[k] + l->outlier[k];
  if (light != NULL)
    for (int k = 0; k < n; k++) l->read[k] += square_of(light[k]);
  if (unseen != NULL)
    for (int k = 0; k < n; k++) l->read[k] += unseen[k] ? nothing : 0;
}

// Steep slopes may be read too small, which no residual shows: those beyond the slopes that presses have shown, and all where the
// model is another unit's, but within a ball's disc only those that the ball does not show. An error of the slope's size is stated
// of both components: a face may lean either way.
static inline void finish(const struct budget *restrict c, const struct lines *restrict l, float *restrict read,
                          float *restrict solved, float *restrict steep, float *restrict whole, float *restrict confidence, ptrdiff_t x,
                          ptrdiff_t y, int n) {
  const float full = square_of(c->full), most = square_of(c->unknown), per_fade = 1 / c->full;
  const float spread = square_of(c->spread), factor = square_of(c->solved);
  const float reach = square_of(c->ball_radius) - square_of((float)y - c->ball_y), left = (float)x - c->ball_x;
  for (int k = 0; k < n; k++) {
    const float size = sqrtf(l->slope[k]), beyond = larger(size - c->shown, 0) * c->per_excess;
    const float doubted = square_of(left + (float)k) < reach ? c->of_ball : c->doubted;
    const float other = c->carried * clamp((size - doubted) * per_fade + 1, 0, 1) * larger(c->steepest - size, 0);
    const float seen = l->read[k] < most ? 1 : 0, missing = seen * smaller(square_of(beyond) + square_of(other), most);
    const float of_unit = spread * l->slope[k];
    read[k] = sqrtf(l->read[k]);
    const float of_solved = smaller(factor * l->read[k], most) + of_unit;
    solved[k] = sqrtf(of_solved);
    steep[k] = sqrtf(missing);
    whole[k] = sqrtf(of_solved + missing);
    confidence[k] = smaller(full / (l->read[k] + of_unit + missing), 1);
  }
}

static inline void write_roots(float *restrict map, const float *restrict variance, int n) {
  if (map != NULL)
    for (int k = 0; k < n; k++) map[k] = sqrtf(variance[k]);
}

#define AT(map) ((map) == NULL ? NULL : (map) + at)

// `read`: deviation of the slopes as read, without the rows of the unit and of steep slopes. `solved`: of the solved depth's
// slopes, with that of the unit. `whole`: of these with that of steep slopes. `walls` and `outliers` get those rows where they are asked for.
EXPORT int slope_budget(const float *gradients, const bool *at_rest, const float *rest, const float *of_step, const float *of_model,
                        const float *residual, const bool *unseen, const float *gain, const float *light, float *read,
                        float *solved, float *steep, float *whole, float *confidence, float *walls, float *outliers, float per_step,
                        float per_size, float solved_factor, float unknown, float outlier, float unseen_sigma,
                        float full, float noise, float per_bend, float bend_from, float spread, float shown,
                        float per_excess, float doubted, float steepest, float carried, float ball_x, float ball_y,
                        float ball_radius, float of_ball, int32_t reach, ptrdiff_t h, ptrdiff_t w) {
  const struct budget c = {per_step, per_size,  solved_factor, unknown, outlier,    unseen_sigma, full,    noise,
                           per_bend, bend_from, spread,        shown,   per_excess, doubted, steepest,     carried,
                           ball_x,   ball_y,    ball_radius,   of_ball, reach};
  if (reach < 1 || !(outlier > 0) || !(full > 0)) return WRONG_SIZE;
  struct lines l = {0};
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x += PIECE) {
      const ptrdiff_t at = y * w + x;
      const int n = w - x < PIECE ? (int)(w - x) : PIECE;
      if (per_bend > 0) {
        find_bend(&c, &l, gradients, x, y, w, h, n);
        variance_of_walls(&c, &l);
      }
      variance_of_outliers(l.outlier, AT(residual), outlier, unknown, n);
      variance_by_law(&c, &l, gradients + 2 * at, at_rest + at, rest + at, AT(of_step), AT(of_model), n);
      add_rows(&c, &l, gain + at, AT(light), AT(unseen), n);
      write_roots(AT(walls), l.wall, n);
      write_roots(AT(outliers), l.outlier, n);
      finish(&c, &l, read + at, solved + at, steep + at, whole + at, confidence + at, x, y, n);
    }
  return OK;
}
