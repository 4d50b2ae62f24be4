// The V-cycle of native/depth/solvers/multigrid/cycle.c for a batch of right sides, without its islands: some percent are enough.
#include "batch.h"

static const float JACOBI = 0.8f, REST = 1.0f - 0.8f;

// A share of the right side, and coupling times guess of all neighbors.
static inline lanes tied(const struct batch_level *b, const struct level *l, bool diagonals, ptrdiff_t i, ptrdiff_t j, float share) {
  const ptrdiff_t at = i * l->stride + j, up = at - l->stride, s = b->stride;
  const lanes *g = lanes_at(b->guess, b, i, j);
  const lanes near = l->east[at] * g[1] + l->east[at - 1] * g[-1] + (l->south[at] * g[s] + l->south[up] * g[-s]);
  const lanes sum = share * *lanes_at(b->right, b, i, j) + near;
  if (!diagonals) return sum;
  return sum + (l->southeast[at] * g[s + 1] + l->southeast[up - 1] * g[-s - 1]) +
         (l->southwest[at] * g[s - 1] + l->southwest[up + 1] * g[-s + 1]);
}

// One Jacobi step from zero; what it leaves of the right side, in `answer` for a moment.
static inline void relax_from_zero(struct batch_level *b, const struct level *l, bool diagonals) {
  for (ptrdiff_t i = 1; i <= b->height; i++)
    for (ptrdiff_t j = 1; j <= b->width; j++)
      *lanes_at(b->guess, b, i, j) = JACOBI * l->inverse[i * l->stride + j] * *lanes_at(b->right, b, i, j);
  for (ptrdiff_t i = 1; i <= b->height; i++)
    for (ptrdiff_t j = 1; j <= b->width; j++) *lanes_at(b->answer, b, i, j) = tied(b, l, diagonals, i, j, REST);
}

// The right side of the coarser level: each of its pixels collects from the nine around it.
static void restrict_to(const struct batch_level *fine, struct batch_level *b, const struct level *l) {
  float *const *w = l->weights;
  const ptrdiff_t s = fine->stride;
  for (ptrdiff_t i = 1; i <= b->height; i++)
    for (ptrdiff_t j = 1; j <= b->width; j++) {
      const ptrdiff_t at = i * l->stride + j, up = at - l->stride;
      const lanes *x = lanes_at(fine->answer, fine, 2 * i - 1, 2 * j - 1);
      *lanes_at(b->right, b, i, j) = x[0] + (w[LEFT][at] * x[1] + w[RIGHT][at - 1] * x[-1]) +
                                     (w[UP][at] * x[s] + w[FROM_NW][at] * x[s + 1] + w[FROM_NE][at - 1] * x[s - 1]) +
                                     (w[DOWN][up] * x[-s] + w[FROM_SW][up] * x[-s + 1] + w[FROM_SE][up - 1] * x[-s - 1]);
    }
}

// Add the coarser level's answer to the guess.
static void interpolate_from(const struct batch_level *b, const struct level *l, struct batch_level *fine) {
  float *const *w = l->weights;
  const ptrdiff_t s = fine->stride, down = b->stride;
  for (ptrdiff_t i = 1; i <= b->height; i++)
    for (ptrdiff_t j = 1; j <= b->width; j++) {
      const ptrdiff_t at = i * l->stride + j;
      const lanes *x = lanes_at(b->answer, b, i, j);
      lanes *g = lanes_at(fine->guess, fine, 2 * i - 1, 2 * j - 1);
      g[0] += x[0];
      g[1] += w[LEFT][at] * x[0] + w[RIGHT][at] * x[1];
      g[s] += w[UP][at] * x[0] + w[DOWN][at] * x[down];
      g[s + 1] += (w[FROM_NW][at] * x[0] + w[FROM_NE][at] * x[1]) + (w[FROM_SW][at] * x[down] + w[FROM_SE][at] * x[down + 1]);
    }
}

// One Jacobi step from the guess.
static inline void relax(struct batch_level *b, const struct level *l, bool diagonals) {
  for (ptrdiff_t i = 1; i <= b->height; i++)
    for (ptrdiff_t j = 1; j <= b->width; j++)
      *lanes_at(b->answer, b, i, j) = REST * *lanes_at(b->guess, b, i, j) +
                                      JACOBI * l->inverse[i * l->stride + j] * tied(b, l, diagonals, i, j, 1);
}

static void answer_coarsest(struct batch_level *b, const float *dense) {
  const ptrdiff_t w = b->width, n = b->height * w;
  for (ptrdiff_t k = 0; k < n; k++) {
    lanes sum = {0};
    for (ptrdiff_t c = 0; c < n; c++) sum += dense[k * COARSEST + c] * *lanes_at(b->right, b, 1 + c / w, 1 + c % w);
    *lanes_at(b->answer, b, 1 + k / w, 1 + k % w) = sum;
  }
}

// Answers of the finest level to its right sides.
void batch_cycle(struct batch *b, const struct multigrid *m) {
  const int last = b->count - 1;
  for (int k = 0; k < last; k++) {
    if (k == 0) relax_from_zero(&b->levels[0], &m->levels[0], false);
    else relax_from_zero(&b->levels[k], &m->levels[k], true);
    restrict_to(&b->levels[k], &b->levels[k + 1], &m->levels[k + 1]);
  }
  answer_coarsest(&b->levels[last], m->dense);
  for (int k = last - 1; k >= 0; k--) {
    interpolate_from(&b->levels[k + 1], &m->levels[k + 1], &b->levels[k]);
    if (k == 0) relax(&b->levels[0], &m->levels[0], false);
    else relax(&b->levels[k], &m->levels[k], true);
  }
}
