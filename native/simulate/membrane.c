// Projected multigrid for a membrane over an obstacle; see simulate/gel.py for the equation and the source.
#include <stdlib.h>

#include "../common.h"

enum { LEVELS = 24, SWEEPS = 2, COARSEST_SWEEPS = 20, COARSEST_SIZE = 5 };

// A grid: unknown (with a border of ghosts), right-hand side, residual, lower bound; where it may move, where it does.
struct level {
  ptrdiff_t h, w;
  double spring;  // the bed's stiffness for a sample
  double *u, *f, *r;
  const double *g;
  bool *free, *moves;
};

struct membrane {
  int count;
  struct level levels[LEVELS];
  double *numbers, *low;
  bool *flags;
};

EXPORT void membrane_free(void *made) {
  struct membrane *m = made;
  if (m) free(m->numbers), free(m->low), free(m->flags);
  free(m);
}

// Grids of half the size each; all but the finest have no obstacle: their bound, shared, is -inf.
EXPORT struct membrane *membrane_new(ptrdiff_t h, ptrdiff_t w) {
  struct membrane *m = calloc(1, sizeof *m);
  if (!m) return NULL;
  ptrdiff_t samples = 0, ghosted = 0;
  for (ptrdiff_t rows = h, columns = w; m->count < LEVELS; rows = (rows + 1) / 2, columns = (columns + 1) / 2) {
    m->levels[m->count++] = (struct level){.h = rows, .w = columns};
    samples += rows * columns, ghosted += (rows + 2) * (columns + 2);
    if (rows < COARSEST_SIZE || columns < COARSEST_SIZE) break;
  }
  m->numbers = calloc((size_t)(2 * samples + ghosted), sizeof(double));
  m->low = malloc((size_t)(h * w) * sizeof(double));
  m->flags = calloc((size_t)(2 * samples), sizeof(bool));
  if (!m->numbers || !m->low || !m->flags) return membrane_free(m), NULL;
  for (ptrdiff_t k = 0; k < h * w; k++) m->low[k] = -INFINITY;
  double *number = m->numbers;
  bool *flag = m->flags;
  for (struct level *l = m->levels; l < m->levels + m->count; l++) {
    const ptrdiff_t size = l->h * l->w;
    l->g = m->low;
    l->u = number, l->f = number + (l->h + 2) * (l->w + 2), l->r = l->f + size, number = l->r + size;
    l->free = flag, l->moves = flag + size, flag += 2 * size;
  }
  return m;
}

// No force across the border: the ghosts are as their neighbors.
static void mirror(double *u, ptrdiff_t h, ptrdiff_t w) {
  const ptrdiff_t pitch = w + 2;
  memcpy(u, u + pitch, (size_t)pitch * sizeof *u);
  memcpy(u + (h + 1) * pitch, u + h * pitch, (size_t)pitch * sizeof *u);
  for (ptrdiff_t i = 0; i < h + 2; i++) u[i * pitch] = u[i * pitch + 1], u[i * pitch + w + 1] = u[i * pitch + w];
}

static inline double pull(const double *u, ptrdiff_t pitch, double f) { return u[-pitch] + u[pitch] + u[-1] + u[1] + f; }

// Projected Gauss-Seidel, red-black.
static void relax(const struct level *l, int sweeps) {
  const ptrdiff_t w = l->w, pitch = w + 2;
  const double factor = 1 / (4 + l->spring);
  for (int half = 0; half < 2 * sweeps; half++) {
    mirror(l->u, l->h, w);
    for (ptrdiff_t i = 0; i < l->h; i++) {
      double *u = l->u + (i + 1) * pitch + 1;
      const double *g = l->g + i * w, *f = l->f + i * w;
      const bool *may_move = l->free + i * w;
      for (ptrdiff_t j = (i + half) % 2; j < w; j += 2) {
        const double balanced = factor * pull(u + j, pitch, f[j]), allowed = balanced > g[j] ? balanced : g[j];
        u[j] = may_move[j] ? allowed : u[j];
      }
    }
  }
}

// Pixels that move are free and do not touch; the residual is 0 elsewhere.
static void find_residual(const struct level *l) {
  const ptrdiff_t w = l->w, pitch = w + 2;
  mirror(l->u, l->h, w);
  for (ptrdiff_t i = 0; i < l->h; i++)
    for (ptrdiff_t j = 0; j < w; j++) {
      const ptrdiff_t k = i * w + j;
      const double *u = l->u + (i + 1) * pitch + j + 1;
      l->moves[k] = l->free[k] & (*u > l->g[k]);
      l->r[k] = l->moves[k] ? pull(u, pitch, l->f[k]) - (4 + l->spring) * *u : 0;
    }
}

// Four times the mean residual of 2x2 samples (the spacing doubles); a coarse sample may move if all four do.
static void restrict_to(const struct level *coarse, const struct level *l) {
  for (ptrdiff_t i = 0; i < coarse->h; i++)
    for (ptrdiff_t j = 0; j < coarse->w; j++) {
      const ptrdiff_t a = 2 * i * l->w + 2 * j, b = 2 * j + 1 < l->w ? a + 1 : a, down = 2 * i + 1 < l->h ? l->w : 0;
      coarse->f[i * coarse->w + j] = l->r[a] + l->r[a + down] + l->r[b] + l->r[b + down];
      coarse->free[i * coarse->w + j] = l->moves[a] & l->moves[a + down] & l->moves[b] & l->moves[b + down];
    }
}

// The coarse correction, bilinear between coarse centers, to what moves.
static void correct(const struct level *l, const struct level *coarse) {
  mirror(coarse->u, coarse->h, coarse->w);
  const ptrdiff_t pitch = coarse->w + 2;
  for (ptrdiff_t i = 0; i < l->h; i++) {
    const double *near = coarse->u + (i / 2 + 1) * pitch, *far = i % 2 ? near + pitch : near - pitch;
    double *u = l->u + (i + 1) * (l->w + 2) + 1;
    for (ptrdiff_t j = 0; j < l->w; j++) {
      const ptrdiff_t a = j / 2 + 1, b = j % 2 ? a + 1 : a - 1;
      const double change = 0.5625 * near[a] + 0.1875 * (far[a] + near[b]) + 0.0625 * far[b], low = l->g[i * l->w + j];
      const double moved = u[j] + change > low ? u[j] + change : low;
      u[j] = l->moves[i * l->w + j] ? moved : u[j];
    }
  }
}

// One V-cycle: relax, correct by the next coarser grid what does not touch, relax.
static void cycle(const struct level *l, const struct level *coarsest) {
  relax(l, l == coarsest ? COARSEST_SWEEPS : SWEEPS);
  if (l == coarsest) return;
  const struct level *coarse = l + 1;
  find_residual(l);
  restrict_to(coarse, l);
  memset(coarse->u, 0, (size_t)((coarse->h + 2) * (coarse->w + 2)) * sizeof(double));
  cycle(coarse, coarsest);
  correct(l, coarse);
  relax(l, SWEEPS);
}

// Up to `cycles` of them, until none changes `u` by more than `target`; `change` is the last one's largest.
EXPORT int membrane_cycles(struct membrane *grids, double *u, double *before, const double *lowest, bool *may_move,
                           double *change, double spring, double target, int32_t cycles, ptrdiff_t gh, ptrdiff_t gw,
                           ptrdiff_t h, ptrdiff_t w) {
  struct level *top = grids->levels, *coarsest = top;
  if (top->h != h || top->w != w || gh != h + 2 || gw != w + 2) return WRONG_SIZE;
  top->u = u, top->g = lowest, top->free = may_move, top->spring = spring;
  while (coarsest < top + grids->count - 1 && coarsest->spring <= 2) coarsest++, coarsest->spring = 4 * coarsest[-1].spring;
  for (int k = 0; k < cycles; k++) {
    memcpy(before, u, (size_t)(gh * gw) * sizeof *u);
    cycle(top, coarsest);
    double largest = 0;
    for (ptrdiff_t i = 1; i <= h; i++)
      for (ptrdiff_t j = 1; j <= w; j++) {
        const double moved = fabs(u[i * gw + j] - before[i * gw + j]);
        largest = moved > largest ? moved : largest;
      }
    *change = largest;
    if (largest <= target) break;
  }
  return OK;
}
