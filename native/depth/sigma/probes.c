// Depths of random slope errors: their right sides, and two V-cycles, of which the first is scaled as a step of conjugate
// gradients would be. That is exact to some percent.
#include "batch.h"

// Draws of slope errors (h, w, 2, n) and how large they are at each block (h, w, 2).
struct errors {
  const float *white_draws, *common_draws, *white, *common, *bias;
  ptrdiff_t h, w, n;
};

// Number of the draws from `first` on that are in one batch.
static size_t bytes_from(const struct errors *e, ptrdiff_t first) {
  return (e->n - first < BATCH ? e->n - first : BATCH) * sizeof(float);
}

static inline lanes load(const float *draws, size_t bytes) {
  lanes x = {0};
  if (bytes == sizeof x) memcpy(&x, draws, sizeof x);
  else memcpy(&x, draws, bytes);
  return x;
}

static inline void store(float *depth, lanes x, size_t bytes) {
  if (bytes == sizeof x) memcpy(depth, &x, sizeof x);
  else memcpy(depth, &x, bytes);
}

// Move what flows over the edge that leaves block (i, j), counted from 0, along `axis`, from one pixel to its neighbor. An
// edge that a column or row put in cuts is two of twice the coupling.
static inline void add_flux(const struct errors *e, struct batch_level *l, const float *coupling, float scale, ptrdiff_t stride,
                            ptrdiff_t i, ptrdiff_t j, int axis, ptrdiff_t first, size_t bytes) {
  const ptrdiff_t fine_i = on_finest(i + 1, e->h), fine_j = on_finest(j + 1, e->w);
  const ptrdiff_t next_i = on_finest(i + 1 + axis, e->h), next_j = on_finest(j + 2 - axis, e->w);
  const float tie = scale * coupling[fine_i * stride + fine_j] / (float)(next_i - fine_i + next_j - fine_j);
  const ptrdiff_t here = 2 * (i * e->w + j) + axis, next = 2 * ((i + axis) * e->w + j + 1 - axis) + axis;
  const lanes a = load(e->white_draws + here * e->n + first, bytes), b = load(e->white_draws + next * e->n + first, bytes);
  const lanes c = load(e->common_draws + here * e->n + first, bytes), bias = load(e->bias + axis * e->n + first, bytes);
  const lanes flux = tie * (e->white[here] * a + e->white[next] * b + (e->common[here] + e->common[next]) * c - 2 * bias);
  *lanes_at(l->right, l, fine_i, fine_j) -= flux;
  *lanes_at(l->right, l, next_i, next_j) += flux;
}

static void write_right_sides(const struct errors *e, struct batch_level *l, const struct level *f, float scale_x, float scale_y,
                              ptrdiff_t first) {
  const size_t bytes = bytes_from(e, first);
  memset(l->right, 0, (l->height + 3) * l->stride * sizeof(lanes));
  for (ptrdiff_t i = 0; i < e->h; i++)
    for (ptrdiff_t j = 0; j < e->w; j++) {
      if (j + 1 < e->w) add_flux(e, l, f->east, scale_x, f->stride, i, j, 0, first, bytes);
      if (i + 1 < e->h) add_flux(e, l, f->south, scale_y, f->stride, i, j, 1, first, bytes);
    }
}

// Length of the step along the answers, as in conjugate gradients; the right sides become the residual of that step. The
// operator times the answers is kept in the guess's place.
static lanes step(struct batch_level *l, const struct level *f) {
  lanes up = {0}, down = {0}, length = {0};
  const ptrdiff_t s = l->stride;
  for (ptrdiff_t i = 1; i <= l->height; i++)
    for (ptrdiff_t j = 1; j <= l->width; j++) {
      const ptrdiff_t at = i * f->stride + j;
      const lanes *x = lanes_at(l->answer, l, i, j);
      const lanes across = f->east[at] * (x[0] - x[1]) + f->east[at - 1] * (x[0] - x[-1]);
      const lanes along = f->south[at] * (x[0] - x[s]) + f->south[at - f->stride] * (x[0] - x[-s]);
      const lanes product = f->anchor[at] * x[0] + across + along;
      *lanes_at(l->guess, l, i, j) = product;
      up += x[0] * *lanes_at(l->right, l, i, j), down += x[0] * product;
    }
  for (int m = 0; m < BATCH; m++) length[m] = down[m] > 0 ? up[m] / down[m] : 0;
  for (ptrdiff_t i = 1; i <= l->height; i++)
    for (ptrdiff_t j = 1; j <= l->width; j++) *lanes_at(l->right, l, i, j) -= length * *lanes_at(l->guess, l, i, j);
  return length;
}

// Depths of draws `first` and on: `length` times the answers, added to what is there if `add` says so.
static void collect(const struct errors *e, struct batch_level *l, ptrdiff_t first, lanes length, bool add, float *depths) {
  const size_t bytes = bytes_from(e, first);
  for (ptrdiff_t i = 0; i < e->h; i++)
    for (ptrdiff_t j = 0; j < e->w; j++) {
      float *depth = depths + (i * e->w + j) * e->n + first;
      lanes x = length * *lanes_at(l->answer, l, on_finest(i + 1, e->h), on_finest(j + 1, e->w));
      if (add) x += load(depth, bytes);
      store(depth, x, bytes);
    }
}

EXPORT int probe_depths(struct multigrid *grid, struct batch *batch, const float *white_draws, const float *common_draws,
                        const float *white, const float *common, const float *bias, float scale_x, float scale_y, float *depths,
                        ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  if (h != grid->height || w != grid->width || !batch_fits(batch, grid)) return WRONG_SIZE;
  const struct errors e = {white_draws, common_draws, white, common, bias, h, w, n};
  struct batch_level *l = batch->levels;
  for (ptrdiff_t first = 0; first < n; first += BATCH) {
    const lanes one = 1.0f - (lanes){0};
    write_right_sides(&e, l, grid->levels, scale_x, scale_y, first);
    batch_cycle(batch, grid);
    collect(&e, l, first, step(l, grid->levels), false, depths);
    batch_cycle(batch, grid);
    collect(&e, l, first, one, true, depths);
  }
  return OK;
}
