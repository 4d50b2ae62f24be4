// The finest level: couplings from weights, right side from slopes.
#include "grid.h"

static const float TINY = 1e-30f;

// 1 over the diagonal of row `i`, whose couplings and those of the row above are there.
static void invert_diagonal(const struct level *l, ptrdiff_t i) {
  const float *e = row(l->east, l, i), *s = row(l->south, l, i), *s_up = s - l->stride, *a = row(l->anchor, l, i);
  float *inverse = row(l->inverse, l, i);
  INDEPENDENT for (ptrdiff_t j = 1; j <= l->width; j++) {
    const float total = e[j] + e[j - 1] + s[j] + s_up[j] + a[j];
    inverse[j] = total > 0 ? 1.0f / total : 0.0f;
  }
}

// The harmonic mean of two pixels' confidence, times `scale`: the variance of an averaged slope is the mean of both.
static bool couple(const float *restrict a, const float *restrict b, float scale, float *restrict coupling, ptrdiff_t n) {
  int changed = 0;
  for (ptrdiff_t j = 0; j < n; j++) {
    const float value = scale * a[j] * b[j] / (a[j] + b[j] + TINY);
    changed |= coupling[j] != value;
    coupling[j] = value;
  }
  return changed;
}

static bool store(const float *restrict values, float *restrict plane, ptrdiff_t n) {
  int changed = 0;
  for (ptrdiff_t j = 0; j < n; j++) {
    changed |= plane[j] != values[j];
    plane[j] = values[j];
  }
  return changed;
}

static bool clear(float *plane, ptrdiff_t n) {
  int changed = 0;
  for (ptrdiff_t j = 0; j < n; j++) changed |= plane[j] != 0;
  memset(plane, 0, n * sizeof *plane);
  return changed;
}

// What flows in over the edges minus what flows out, of slopes in row `i`; `down` is what comes from the row above.
static void right_side_row(const struct level *l, ptrdiff_t i, const float *restrict g, float gx, float gy,
                           float *restrict across, float *restrict down) {
  const float *restrict e = row(l->east, l, i) + 1, *restrict s = row(l->south, l, i) + 1, *restrict low = g + 2 * l->width;
  float *restrict right = row(l->right, l, i) + 1;
  const ptrdiff_t w = l->width;
  across[0] = across[w] = 0;
  for (ptrdiff_t j = 0; j < w - 1; j++) across[j + 1] = gx * e[j] * (g[2 * j] + g[2 * j + 2]);
  for (ptrdiff_t j = 0; j < w; j++) right[j] = across[j] - across[j + 1] + down[j];
  if (i == l->height) return;
  for (ptrdiff_t j = 0; j < w; j++) {
    down[j] = gy * s[j] * (g[2 * j + 1] + low[2 * j + 1]);
    right[j] -= down[j];
  }
}

// Writes couplings and right side; returns 1 if the coarse levels have to be built anew.
EXPORT int multigrid_load(struct multigrid *grid, const float *gradients, const float *confidence, const float *anchor, float hx,
                          float hy, ptrdiff_t h, ptrdiff_t w) {
  const struct level *l = grid->levels;
  if (h != l->height || w != l->width) return WRONG_SIZE;
  float *across = grid->lines, *down = across + grid->line;
  bool changed = !grid->built;
  memset(down, 0, w * sizeof *down);
  grid->largest = 0;
  for (ptrdiff_t i = 1; i <= h; i++) {
    const float *c = confidence + (i - 1) * w;
    float *a = row(l->anchor, l, i) + 1;
    changed |= anchor ? store(anchor + (i - 1) * w, a, w) : clear(a, w);
    changed |= couple(c, c + 1, 2 * hy / hx, row(l->east, l, i) + 1, w - 1);
    if (i < h) changed |= couple(c, c + w, 2 * hx / hy, row(l->south, l, i) + 1, w);
    if (changed) invert_diagonal(l, i);
    right_side_row(l, i, gradients + (i - 1) * w * 2, 0.5f * hx, 0.5f * hy, across, down);
    grid->largest = larger(largest_magnitude(row(l->right, l, i) + 1, w), grid->largest);
  }
  grid->built &= !changed;
  return changed;
}

// The same of couplings (h, w - 1) and (h - 1, w), one for each edge, and of a right side that is given.
EXPORT int multigrid_load_edges(struct multigrid *grid, const float *east, const float *south, const float *anchor,
                                const float *right, ptrdiff_t h, ptrdiff_t edges, ptrdiff_t rows, ptrdiff_t w) {
  const struct level *l = grid->levels;
  if (h != l->height || w != l->width || edges != w - 1 || rows != h - 1) return WRONG_SIZE;
  for (ptrdiff_t i = 1; i <= h; i++) {
    store(anchor + (i - 1) * w, row(l->anchor, l, i) + 1, w);
    store(east + (i - 1) * edges, row(l->east, l, i) + 1, edges);
    if (i < h) store(south + (i - 1) * w, row(l->south, l, i) + 1, w);
    store(right + (i - 1) * w, row(l->right, l, i) + 1, w);
    invert_diagonal(l, i);
  }
  grid->largest = largest_magnitude(right, h * w);
  grid->built = false;
  return 1;
}

// The coarse levels of the couplings that are loaded.
EXPORT int multigrid_build(struct multigrid *grid) {
  for (int k = 0; k + 1 < grid->count; k++) coarsen(grid, k);
  invert_coarsest(grid);
  find_islands(grid);
  grid->built = true;
  return OK;
}
