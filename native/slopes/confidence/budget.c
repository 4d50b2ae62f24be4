// The variance of each slope of a frame: the sum of named rows, in one pass.
#include "../../common.h"
#include "outlier.h"

enum { PIECE = 64 };  // pixels of a row at a time

// What the rows are computed with, in the order of the caller's array, which `slope_budget_names` tells.
#define NUMBERS(NUMBER)                                                                                                        \
  NUMBER(per_step) NUMBER(per_size) NUMBER(solved_factor) NUMBER(unknown) NUMBER(outlier) NUMBER(unseen_sigma) NUMBER(full)   \
  NUMBER(noise) NUMBER(per_bend) NUMBER(bend_from) NUMBER(spread) NUMBER(shown) NUMBER(per_excess) NUMBER(doubted)            \
  NUMBER(steepest) NUMBER(carried) NUMBER(ball_x) NUMBER(ball_y) NUMBER(ball_radius) NUMBER(of_ball) NUMBER(reach)

// The rows in the order in which they are added: each has a function `variance_of_...`, and raises the deviation of the slopes as
// they were READ (and all that follow), of the SOLVED depth's slopes too (and all), or only that of the WHOLE.
#define ROWS(ROW)                                                                                                              \
  ROW(compression, READ) ROW(wall, READ) ROW(outlier, READ) ROW(light, READ) ROW(unseen, READ) ROW(unit, SOLVED)             \
  ROW(steep, WHOLE)

enum { READ, SOLVED, WHOLE };
#define ONE(name, raised) +1
enum { ROW_COUNT = 0 ROWS(ONE) };

#define FIELD(name) float name;
struct numbers {
  NUMBERS(FIELD)
};
enum { NUMBER_COUNT = sizeof(struct numbers) / sizeof(float) };

struct frame {
  const struct numbers *c;
  const float *gradients, *rest, *of_step, *of_model, *residual, *gain, *light;  // the maps that a row may read; optional ones NULL
  const bool *at_rest, *unseen;
  ptrdiff_t h, w;
};

struct piece {
  ptrdiff_t x, y, at;  // its first pixel, and the place of that in a map
  int n;
  float slope[PIECE], law[PIECE], read[PIECE];  // squared slope, variance by the law, and with the rows so far
};

static inline void add_squares(float *restrict sums, const float *restrict here, const float *restrict there, int first, int end) {
  for (int i = first; i < end; i++) sums[i] += square_of(there[i] - here[i]);
}

static inline void all_squares(float *restrict sums, const float *restrict at, ptrdiff_t across, ptrdiff_t down) {
  for (ptrdiff_t i = 0; i < 2 * PIECE; i++)
    sums[i] = ((square_of(at[i - across] - at[i]) + square_of(at[i + across] - at[i])) + square_of(at[i - down] - at[i])) + square_of(at[i + down] - at[i]);
}

// Squares of the differences of the slopes (p, q) of a piece to those `reach` pixels away on four sides.
static inline void find_bend(float *restrict bend, const struct frame *f, const struct piece *p) {
  const ptrdiff_t w = f->w, h = f->h, x = p->x, y = p->y, reach = (ptrdiff_t)f->c->reach, left = reach - x, right = w - reach - x;
  const float *at = f->gradients + 2 * p->at;
  const int n = p->n;
  if (n == PIECE && left <= 0 && right >= n && y >= reach && y < h - reach) {  // nearly everywhere
    all_squares(bend, at, 2 * reach, 2 * reach * w);
    return;
  }
  memset(bend, 0, 2 * PIECE * sizeof *bend);
  if (left < n) add_squares(bend, at, at - 2 * reach, 2 * (left > 0 ? (int)left : 0), 2 * n);
  if (right > 0) add_squares(bend, at, at + 2 * reach, 0, 2 * (right < n ? (int)right : n));
  if (y >= reach) add_squares(bend, at, at - 2 * reach * w, 0, 2 * n);
  if (y < h - reach) add_squares(bend, at, at + 2 * reach * w, 0, 2 * n);
}

// At rest by place; elsewhere by the step and the slope's size.
static inline void variance_by_law(struct piece *restrict p, const struct frame *f) {
  const float *slopes = f->gradients + 2 * p->at, per_step = f->c->per_step, per_size = f->c->per_size;
  for (int k = 0; k < p->n; k++) p->slope[k] = square_of(slopes[2 * k]) + square_of(slopes[2 * k + 1]);
  for (int k = 0; k < p->n; k++) p->law[k] = per_step + per_size * p->slope[k];
  if (f->of_step != NULL)
    for (int k = 0; k < p->n; k++) p->law[k] *= f->of_step[p->at + k];
  for (int k = 0; k < p->n; k++) p->law[k] = f->at_rest[p->at + k] ? f->rest[p->at + k] : p->law[k];
}

// Each of these writes the variances of a row in a piece, and returns false if there is none, which needs no writing.

static inline bool variance_of_compression(float *restrict variance, const struct frame *f, const struct piece *p) {
  if (!(f->c->noise > 0)) return false;
  for (int k = 0; k < p->n; k++) variance[k] = square_of(f->c->noise * f->gain[p->at + k]);
  return true;
}

// Slopes that differ by more than `bend_from` from those around them are blurred.
static inline bool variance_of_wall(float *restrict variance, const struct frame *f, const struct piece *p) {
  const float per_bend = f->c->per_bend, from = f->c->bend_from;
  if (!(per_bend > 0)) return false;
  float bend[2 * PIECE], square[PIECE];
  find_bend(bend, f, p);
  for (int k = 0; k < PIECE; k++) square[k] = 0.5f * (bend[2 * k] + bend[2 * k + 1]);
  if (!any_from(square, square_of(from), PIECE)) return false;
  for (int k = 0; k < PIECE; k++) variance[k] = square_of(per_bend * larger(sqrtf(square[k]) - from, 0));
  return true;
}

// With what a color model's own deviation exceeds the law by. What clips, is hidden or is not lit is no color, so it has none.
static inline bool variance_of_outlier(float *restrict variance, const struct frame *f, const struct piece *p) {
  if (f->residual == NULL && f->of_model == NULL) return false;
  const float nothing = square_of(f->c->unseen_sigma);
  variance_of_outliers(variance, f->residual == NULL ? NULL : f->residual + p->at, f->c->outlier, f->c->unknown, p->n);
  if (f->of_model != NULL)
    for (int k = 0; k < p->n; k++) variance[k] += larger(square_of(f->of_model[p->at + k]) - p->law[k], 0);
  for (int k = 0; k < p->n; k++) variance[k] = smaller(variance[k], nothing);
  if (f->unseen != NULL)
    for (int k = 0; k < p->n; k++) variance[k] = f->unseen[p->at + k] ? 0 : variance[k];
  return true;
}

static inline bool variance_of_light(float *restrict variance, const struct frame *f, const struct piece *p) {
  if (f->light == NULL) return false;
  for (int k = 0; k < p->n; k++) variance[k] = square_of(f->light[p->at + k]);
  return true;
}

static inline bool variance_of_unseen(float *restrict variance, const struct frame *f, const struct piece *p) {
  if (f->unseen == NULL) return false;
  const float nothing = square_of(f->c->unseen_sigma);
  for (int k = 0; k < p->n; k++) variance[k] = f->unseen[p->at + k] ? nothing : 0;
  return true;
}

static inline bool variance_of_unit(float *restrict variance, const struct frame *f, const struct piece *p) {
  if (!(f->c->spread > 0)) return false;
  const float spread = square_of(f->c->spread);
  for (int k = 0; k < p->n; k++) variance[k] = spread * p->slope[k];
  return true;
}

// Steep slopes may be read too small, which no residual shows: those beyond the slopes that presses have shown, and all where the
// model is another unit's, but within a ball's disc only those that the ball does not show. An error of the slope's size is stated
// of both components: a face may lean either way.
static inline bool variance_of_steep(float *restrict variance, const struct frame *f, const struct piece *p) {
  const struct numbers c = *f->c;
  const float most = square_of(c.unknown), per_fade = 1 / c.full;
  const float reach = square_of(c.ball_radius) - square_of((float)p->y - c.ball_y), left = (float)p->x - c.ball_x;
  for (int k = 0; k < p->n; k++) {
    const float size = sqrtf(p->slope[k]), beyond = larger(size - c.shown, 0) * c.per_excess;
    const float doubted = square_of(left + (float)k) < reach ? c.of_ball : c.doubted;
    const float other = c.carried * clamp((size - doubted) * per_fade + 1, 0, 1) * larger(c.steepest - size, 0);
    variance[k] = (p->read[k] < most ? 1 : 0) * smaller(square_of(beyond) + square_of(other), most);
  }
  return true;
}

static inline void write_roots(float *restrict map, const float *restrict variance, int n) {
  for (int k = 0; k < n; k++) map[k] = sqrtf(variance[k]);
}

static inline void take_row(bool there, float *restrict variance, float *restrict sums, float *restrict part, int n) {
  for (int k = 0; there && k < n; k++) sums[k] += variance[k];
  if (part == NULL) return;
  if (!there) memset(variance, 0, (size_t)n * sizeof *variance);
  write_roots(part, variance, n);
}

static inline void finish(const struct numbers *restrict c, const float *restrict as_read, const float *restrict of_solved,
                          const float *restrict of_whole, float *restrict read, float *restrict solved, float *restrict steep,
                          float *restrict whole, float *restrict confidence, int n) {
  const float full = square_of(c->full), most = square_of(c->unknown), factor = square_of(c->solved_factor);
  for (int k = 0; k < n; k++) {
    const float all = smaller(factor * as_read[k], most) + of_solved[k];
    read[k] = sqrtf(as_read[k]), solved[k] = sqrtf(all), steep[k] = sqrtf(of_whole[k]), whole[k] = sqrtf(all + of_whole[k]);
    confidence[k] = smaller(full / (as_read[k] + of_solved[k] + of_whole[k]), 1);
  }
}

// Writes, up to n letters, the names of `NUMBERS`, then "law" and those of `ROWS`, each behind a space; returns how many they are.
EXPORT int slope_budget_names(uint8_t *text, ptrdiff_t n) {
#define NAME(name) " " #name
#define ROW_NAME(name, raised) " " #name
  static const char names[] = NUMBERS(NAME) " law" ROWS(ROW_NAME);
  const ptrdiff_t all = (ptrdiff_t)sizeof names - 1;
  memcpy(text, names, (size_t)(n < all ? n : all));
  return (int)all;
}

// `read`: deviation of the slopes as read. `solved`: of the solved depth's slopes. `whole`: of these with all rows, `steep` of that
// row alone. `rows`, where it is asked for, gets the law's deviation and that of each row (1 + rows, h, w).
EXPORT int slope_budget(const float *gradients, const bool *at_rest, const float *rest, const float *of_step, const float *of_model,
                        const float *residual, const bool *unseen, const float *gain, const float *light, float *read,
                        float *solved, float *steep, float *whole, float *confidence, float *rows, const float *numbers,
                        ptrdiff_t h, ptrdiff_t w, ptrdiff_t parts, ptrdiff_t count) {
  struct numbers c;
  if (count != NUMBER_COUNT || (rows != NULL && parts != 1 + ROW_COUNT)) return WRONG_SIZE;
  memcpy(&c, numbers, sizeof c);
  if (!(c.reach >= 1 && c.reach < (float)PTRDIFF_MAX / 4) || !(c.outlier > 0) || !(c.full > 0)) return WRONG_SIZE;
  const struct frame f = {&c, gradients, rest, of_step, of_model, residual, gain, light, at_rest, unseen, h, w};
  struct piece p = {0};
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x += PIECE) {
      p.x = x, p.y = y, p.at = y * w + x, p.n = w - x < PIECE ? (int)(w - x) : PIECE;
      float variance[PIECE], of_solved[PIECE] = {0}, of_whole[PIECE] = {0};
      variance_by_law(&p, &f);
      memcpy(p.read, p.law, sizeof p.law);
      float *sums[] = {p.read, of_solved, of_whole}, *part = rows == NULL ? NULL : rows + p.at;
      if (rows != NULL) write_roots(part, p.law, p.n);
#define TAKE(name, raised) \
  take_row(variance_of_##name(variance, &f, &p), variance, sums[raised], rows == NULL ? NULL : (part += h * w), p.n);
      ROWS(TAKE)
      finish(&c, p.read, of_solved, of_whole, read + p.at, solved + p.at, steep + p.at, whole + p.at, confidence + p.at, p.n);
    }
  return OK;
}
