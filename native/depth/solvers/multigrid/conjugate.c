// Conjugate gradients on the finest level, preconditioned by one V-cycle.
#include "grid.h"

enum { NOT_CONVERGED = 1, NOT_FINITE = 2 };
enum { PAST = 4 };  // iterations over which the recent rate is taken

// The range of the answers over the iterations: each answer estimates the whole error before it is added.
struct history {
  int done;
  double first, whole, past[PAST];
  double least;  // estimate so far
};

// The limit of float32's rounding. Without an anchor nothing holds the sum of the right side at 0; beyond this limit the
// iteration would take what rounding leaves of it for an error, and chase it ever farther.
static const double RESOLVED = 1e-6;

static bool only_rounding_is_left(struct history *h, double estimate) {
  const bool rising = h->done > 0 && h->least < RESOLVED && estimate > h->least;
  if (h->done == 0 || estimate < h->least) h->least = estimate;
  return rising;
}

// x^(1/n), x >= 0, by Newton's method: the libraries' pow differs between platforms, and would stop here or there.
static double root(double x, int n) {
  double y = x > 1 ? x : 1;
  for (int k = 0; k < 200 && x > 0; k++) {
    double power = 1;
    for (int j = 1; j < n && power > 0; j++) power *= y;
    const double next = y - (y - x / power) / n;
    if (!(next < y)) return y;
    y = next;
  }
  return x > 0 ? y : 0;
}

// The largest error that is left, as a share of the whole, once an answer of range `left` is added to the depth.
//
// 4 rate/(1 - rate) times the answer's range is on the safe side in trials. The rate is the mean so far, or over the last
// four iterations where that is slower; and where many iterations are needed, a cycle sees less of the error, hence their
// count in place of 4 (12 at most: float32 ends at 1e-6).
static double estimated_error(struct history *h, double left, double scale) {
  double estimate;
  if (h->done == 0) {
    h->first = left;
    h->whole = scale > 0 ? scale : left;
    estimate = left == 0 ? 0 : INFINITY;
  } else {
    double rate = root(left / h->first, h->done);
    const double recent = h->done > PAST ? root(left / h->past[h->done % PAST], PAST) : 0;
    rate = recent > rate ? recent : rate;
    rate = rate < 0.8 ? rate : 0.8;
    const int doubt = h->done <= PAST ? 4 : h->done < 12 ? h->done : 12;
    estimate = left / h->whole * doubt * rate / (1 - rate);
  }
  h->past[h->done % PAST] = left;
  return estimate;
}

static void turn_row(const struct multigrid *m, ptrdiff_t i, float turn) {
  const float *restrict answer = row(m->levels->answer, m->levels, i);
  float *restrict search = row(m->search, m->levels, i);
  for (ptrdiff_t j = 1; j <= m->levels->width; j++) search[j] = answer[j] + turn * search[j];
}

static double multiply_row(const struct multigrid *m, ptrdiff_t i) {
  const struct level *l = m->levels;
  const float *restrict p = row(m->search, l, i), *restrict up = p - l->stride, *restrict low = p + l->stride;
  const float *restrict a = row(l->anchor, l, i), *restrict e = row(l->east, l, i), *restrict s = row(l->south, l, i);
  const float *restrict s_up = s - l->stride;
  float *restrict product = row(m->product, l, i);
  for (ptrdiff_t j = 1; j <= l->width; j++) {
    const float along = e[j] * (p[j] - p[j + 1]) + e[j - 1] * (p[j] - p[j - 1]);
    product[j] = a[j] * p[j] + (along + (s[j] * (p[j] - low[j]) + s_up[j] * (p[j] - up[j])));
  }
  return dot(p + 1, product + 1, l->width);
}

// The operator times the next search direction, `answer + turn * direction`; returns their product.
static double multiply_next(const struct multigrid *m, float turn, bool first) {
  double total = 0;
  for (ptrdiff_t i = 0; i <= m->levels->height; i++) {
    if (i < m->levels->height && !first) turn_row(m, i + 1, turn);
    if (i > 0) total += multiply_row(m, i);
  }
  return total;
}

// The first direction is the first answer itself.
static void take_answer(struct multigrid *m) {
  float *taken = m->levels->answer;
  m->levels->answer = m->search;
  m->search = taken;
}

// Depth in row `i`, counted from 1, of the frame.
static void depth_row(const struct multigrid *m, ptrdiff_t i, float scale, bool moved, float *restrict depth) {
  const struct level *l = m->levels;
  const ptrdiff_t k = on_finest(i, m->height), w = m->width, last = on_finest(w, w);
  const float *restrict answer = row(l->answer, l, k), *restrict found = row(m->depth, l, k);
  if (moved)
    for (ptrdiff_t j = 1; j < w; j++) depth[j - 1] = scale * (found[j] + answer[j]);
  else
    for (ptrdiff_t j = 1; j < w; j++) depth[j - 1] = scale * answer[j];
  depth[w - 1] = scale * ((moved ? found[last] : 0) + answer[last]);
}

// Depth of what was found, scaled, added to where it started from; false if it is not finite.
static bool write_depth(const struct multigrid *m, const float *start, float scale, bool moved, float *depth) {
  const ptrdiff_t w = m->width;
  float zero = 0;
  for (ptrdiff_t i = 1; i <= m->height; i++, depth += w) {
    depth_row(m, i, scale, moved, depth);
    if (start)
      for (ptrdiff_t j = 0; j < w; j++) depth[j] += start[(i - 1) * w + j];
    zero += times_zero(depth, w);
  }
  return zero == 0;
}

// The power of two that brings the right side near 1, so that no product over- or underflows; 1 for usual slopes.
static float usual_scale(float largest) {
  if (largest > 1e-9f && largest < 1e9f) return 1;
  int exponent;
  frexpf(largest, &exponent);
  return ldexpf(1, exponent);
}

static void scale_right_side(const struct level *l, float factor) {
  for (ptrdiff_t i = 1; i <= l->height; i++)
    for (ptrdiff_t j = 1; j <= l->width; j++) row(l->right, l, i)[j] *= factor;
}

// Depth for the right side that is loaded, added to `start`; report: iterations, estimated error as a share of `whole`, or of
// the range of the first answer where that is 0.
EXPORT int multigrid_solve(struct multigrid *grid, const float *start, float *depth, double whole, double tolerance, int32_t limit,
                           double *report, ptrdiff_t h, ptrdiff_t w) {
  if (h != grid->height || w != grid->width) return WRONG_SIZE;
  const float scale = usual_scale(grid->largest);
  if (scale != 1) scale_right_side(grid->levels, 1 / scale);
  struct history history = {0};
  struct step step = {0};
  double before = 1;
  for (;; history.done++) {
    const struct answer answer = cycle(grid, step);
    report[0] = history.done;
    report[1] = estimated_error(&history, (double)answer.high - answer.low, whole / scale);
    if (!(report[1] > tolerance) || history.done >= limit || only_rounding_is_left(&history, report[1])) break;
    const bool first = history.done == 0;
    if (first) take_answer(grid);
    const double curvature = multiply_next(grid, (float)(answer.product / before), first);
    if (!(curvature > 0)) break;
    step = (struct step){true, first, (float)(answer.product / curvature)};
    before = answer.product;
  }
  if (!write_depth(grid, start, scale, step.pending, depth)) return NOT_FINITE;
  return report[1] <= tolerance ? OK : NOT_CONVERGED;
}

// A plane of a level, without its border, in the order of struct level: for tests.
EXPORT int multigrid_plane(struct multigrid *grid, int32_t level, int32_t plane, float *values, ptrdiff_t h, ptrdiff_t w) {
  const struct level *l = &grid->levels[level];
  if (level < 0 || level >= grid->count || h != l->height || w != l->width) return WRONG_SIZE;
  const float *planes[] = {l->east, l->south, l->southeast, l->southwest, l->anchor, l->inverse, l->right, l->answer};
  const float *from = plane < 8 ? planes[plane] : l->weights[plane - 8];
  if (!from) return 1;
  for (ptrdiff_t i = 1; i <= h; i++) memcpy(values + (i - 1) * w, from + i * l->stride + 1, w * sizeof(float));
  return OK;
}
