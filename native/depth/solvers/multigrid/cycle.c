// One V-cycle: nearly the operator's inverse times the right side, symmetric and positive, so that conjugate gradients may
// be preconditioned with it. Jacobi's method relaxes before and after; guesses live in three lines only, since computing
// them again costs less than memory does.
#include "grid.h"

static const float JACOBI = 0.8f, REST = 1.0f - 0.8f;

// Guesses of three rows, one of them finished and one to come.
struct ring {
  float *above, *here, *below;
};

static struct ring ring_of(const struct multigrid *m) {
  memset(m->lines, 0, 3 * m->line * sizeof(float));
  return (struct ring){m->lines, m->lines + m->line, m->lines + 2 * m->line};
}

static void next_row(struct ring *g) { *g = (struct ring){g->here, g->below, g->above}; }

// One Jacobi step from zero.
static void guess_row(const struct level *l, ptrdiff_t i, float *restrict guess) {
  const float *restrict inverse = row(l->inverse, l, i), *restrict right = row(l->right, l, i);
  for (ptrdiff_t j = 1; j <= l->width; j++) guess[j] = JACOBI * inverse[j] * right[j];
}

// `share` of the right side, and coupling times guess of all neighbors.
static inline void tied_row(const struct level *l, ptrdiff_t i, bool diagonals, const struct ring *g, float share, float *restrict out) {
  const float *restrict right = row(l->right, l, i), *restrict e = row(l->east, l, i), *restrict s = row(l->south, l, i);
  const float *restrict here = g->here, *restrict above = g->above, *restrict below = g->below, *restrict s_up = s - l->stride;
  if (!diagonals) {
    for (ptrdiff_t j = 1; j <= l->width; j++)
      out[j] = share * right[j] + (e[j] * here[j + 1] + e[j - 1] * here[j - 1]) + (s[j] * below[j] + s_up[j] * above[j]);
    return;
  }
  const float *restrict se = row(l->southeast, l, i), *restrict sw = row(l->southwest, l, i);
  const float *restrict se_up = se - l->stride, *restrict sw_up = sw - l->stride;
  for (ptrdiff_t j = 1; j <= l->width; j++) {
    const float near = (e[j] * here[j + 1] + e[j - 1] * here[j - 1]) + (s[j] * below[j] + s_up[j] * above[j]);
    const float far = (se[j] * below[j + 1] + se_up[j - 1] * above[j - 1]) + (sw[j] * below[j - 1] + sw_up[j + 1] * above[j + 1]);
    out[j] = share * right[j] + (near + far);
  }
}

// Add the residual of fine row `i` to the coarse rows that it is interpolated from.
static void restrict_row(const struct level *c, ptrdiff_t i, const float *restrict fine) {
  const ptrdiff_t k = (i + 1) / 2, at = k * c->stride;
  float *restrict right = c->right + at, *restrict below = right + c->stride;
  if (i % 2) {
    const float *restrict l = c->weights[LEFT] + at, *restrict r = c->weights[RIGHT] + at;
    for (ptrdiff_t j = 1; j <= c->width; j++) right[j] += fine[2 * j - 1] + (l[j] * fine[2 * j] + r[j - 1] * fine[2 * j - 2]);
    return;
  }
  const float *restrict up = c->weights[UP] + at, *restrict down = c->weights[DOWN] + at;
  const float *restrict nw = c->weights[FROM_NW] + at, *restrict ne = c->weights[FROM_NE] + at;
  const float *restrict sw = c->weights[FROM_SW] + at, *restrict se = c->weights[FROM_SE] + at;
  for (ptrdiff_t j = 1; j <= c->width; j++) {
    right[j] += up[j] * fine[2 * j - 1] + (nw[j] * fine[2 * j] + ne[j - 1] * fine[2 * j - 2]);
    below[j] = down[j] * fine[2 * j - 1] + (sw[j] * fine[2 * j] + se[j - 1] * fine[2 * j - 2]);
  }
}

// Add the coarse answer to the guess of fine row `i`.
static void interpolate_row(const struct level *c, ptrdiff_t i, float *restrict guess) {
  const ptrdiff_t k = (i + 1) / 2, at = k * c->stride;
  const float *restrict x = c->answer + at, *restrict y = x + c->stride;
  if (i % 2) {
    const float *restrict l = c->weights[LEFT] + at, *restrict r = c->weights[RIGHT] + at;
    for (ptrdiff_t j = 1; j <= c->width; j++) {
      const float at = guess[2 * j - 1] + x[j], after = guess[2 * j] + (l[j] * x[j] + r[j] * x[j + 1]);
      guess[2 * j - 1] = at, guess[2 * j] = after;
    }
    return;
  }
  const float *restrict up = c->weights[UP] + at, *restrict down = c->weights[DOWN] + at;
  const float *restrict nw = c->weights[FROM_NW] + at, *restrict ne = c->weights[FROM_NE] + at;
  const float *restrict sw = c->weights[FROM_SW] + at, *restrict se = c->weights[FROM_SE] + at;
  for (ptrdiff_t j = 1; j <= c->width; j++) {
    const float at = guess[2 * j - 1] + (up[j] * x[j] + down[j] * y[j]);
    const float after = guess[2 * j] + ((nw[j] * x[j] + ne[j] * x[j + 1]) + (sw[j] * y[j] + se[j] * y[j + 1]));
    guess[2 * j - 1] = at, guess[2 * j] = after;
  }
}

// The answer in row `i`, of a guess and of what is tied to it.
static void answer_row(const struct level *l, ptrdiff_t i, const float *restrict guess, const float *restrict tied) {
  const float *restrict inverse = row(l->inverse, l, i);
  float *restrict answer = row(l->answer, l, i);
  for (ptrdiff_t j = 1; j <= l->width; j++) answer[j] = REST * guess[j] + JACOBI * inverse[j] * tied[j];
}

// Product with the right side, and range, of row `i` of the answer.
static void look_at_row(const struct level *l, ptrdiff_t i, struct answer *answer) {
  const float *restrict x = row(l->answer, l, i) + 1;
  const struct range range = range_of(x, l->width);
  answer->product += dot(x, row(l->right, l, i) + 1, l->width);
  answer->low = smaller(range.low, answer->low);
  answer->high = larger(range.high, answer->high);
}

// Take the pending step in row `i`: depth, and what it leaves of the right side.
static void advance_row(const struct multigrid *m, ptrdiff_t i, struct step step) {
  const struct level *l = m->levels;
  const float *restrict search = row(m->search, l, i), *restrict product = row(m->product, l, i), s = step.length;
  float *restrict depth = row(m->depth, l, i), *restrict right = row(l->right, l, i);
  for (ptrdiff_t j = 1; j <= l->width; j++) right[j] -= s * product[j];
  if (step.first)
    for (ptrdiff_t j = 1; j <= l->width; j++) depth[j] = s * search[j];
  else
    for (ptrdiff_t j = 1; j <= l->width; j++) depth[j] += s * search[j];
}

// Relax from zero; the residual becomes the right side of the coarser level.
static inline void descend(struct multigrid *m, int level, struct step step) {
  const struct level *f = &m->levels[level], *c = f + 1;
  struct ring guess = ring_of(m);
  float *residual = m->lines + 3 * m->line;
  memset(row(c->right, c, 1), 0, c->stride * sizeof(float));
  for (ptrdiff_t i = 1; i <= f->height + 1; i++, next_row(&guess)) {
    if (i > f->height) memset(guess.below, 0, m->line * sizeof(float));
    else {
      if (step.pending) advance_row(m, i, step);
      guess_row(f, i, guess.below);
      if (level == 0) add_shifts(&m->islands, i, guess.below);
    }
    if (i == 1) continue;
    tied_row(f, i - 1, level > 0, &guess, REST, residual);
    if (level == 0) subtract_shifts(m, i - 1, residual);
    restrict_row(c, i - 1, residual);
  }
}

// Relax what the coarser level answers, added to the guess.
static inline void ascend(struct multigrid *m, int level, struct answer *answer) {
  const struct level *f = &m->levels[level], *c = f + 1;
  struct ring guess = ring_of(m);
  float *tied = m->lines + 3 * m->line;
  for (ptrdiff_t i = 1; i <= f->height + 1; i++, next_row(&guess)) {
    if (i > f->height) memset(guess.below, 0, m->line * sizeof(float));
    else {
      guess_row(f, i, guess.below);
      if (level == 0) add_shifts(&m->islands, i, guess.below);
      interpolate_row(c, i, guess.below);
    }
    if (i == 1) continue;
    tied_row(f, i - 1, level > 0, &guess, 1, tied);
    answer_row(f, i - 1, guess.here, tied);
    if (level > 0) continue;
    add_residuals(m, i - 1, guess.here, tied);
    look_at_row(f, i - 1, answer);
  }
}

// The frame itself is the coarsest level here.
static struct answer answer_directly(struct multigrid *m, struct step step) {
  struct answer answer = {0, INFINITY, -INFINITY};
  for (ptrdiff_t i = 1; step.pending && i <= m->levels[0].height; i++) advance_row(m, i, step);
  solve_coarsest(m);
  for (ptrdiff_t i = 1; i <= m->levels[0].height; i++) look_at_row(m->levels, i, &answer);
  return answer;
}

// Take the pending step, then answer to the right side that it leaves.
struct answer cycle(struct multigrid *m, struct step step) {
  if (m->count == 1) return answer_directly(m, step);
  struct answer answer = {0, INFINITY, -INFINITY};
  shift_before(m, step);
  descend(m, 0, step);
  for (int k = 1; k < m->count - 1; k++) descend(m, k, (struct step){0});
  solve_coarsest(m);
  for (int k = m->count - 2; k > 0; k--) ascend(m, k, &answer);
  shift_between(m);
  ascend(m, 0, &answer);
  shift_after(m, &answer);
  return answer;
}
