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
static void couple(const float *restrict a, const float *restrict b, float scale, float *restrict coupling, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) coupling[j] = scale * a[j] * b[j] / (a[j] + b[j] + TINY);
}

static bool store(const float *restrict values, float *restrict plane, ptrdiff_t n) {
  int changed = 0;
  for (ptrdiff_t j = 0; j < n; j++) {
    changed |= plane[j] != values[j];
    plane[j] = values[j];
  }
  return changed;
}

// A row of a frame, of n pixels: the last one goes to the last column.
static bool store_pixels(const float *values, float *plane, ptrdiff_t n) {
  bool changed = store(values, plane + 1, n - 1);
  changed |= store(values + n - 1, plane + on_finest(n, n), 1);
  return changed;
}

// The right side of row `i` of the frame; that of a column or row put in is 0, and was changed by the last solution.
static void store_right_side(const struct multigrid *m, ptrdiff_t i, const float *values) {
  const struct level *l = m->levels;
  float *plane = row(l->right, l, on_finest(i, m->height));
  if (i == m->height && m->height % 2 == 0) memset(plane - l->stride, 0, l->stride * sizeof(float));
  plane[m->width] = 0;
  store_pixels(values, plane, m->width);
}

// Couplings between the n pixels of a row: where a column is put in before the last, its edge is two.
static bool store_edges(const float *values, float *plane, ptrdiff_t n) {
  if (n < 2) return false;
  if (n % 2) return store(values, plane + 1, n - 1);
  const float half[] = {2 * values[n - 2], 2 * values[n - 2]};
  bool changed = store(values, plane + 1, n - 2);
  changed |= store(half, plane + n - 1, 2);
  return changed;
}

// Couplings from row `i` of the frame to the next.
static bool store_edges_down(struct multigrid *m, ptrdiff_t i, float *values) {
  const struct level *l = m->levels;
  const bool cut = i == m->height - 1 && m->height % 2 == 0;
  for (ptrdiff_t j = 0; cut && j < m->width; j++) values[j] *= 2;
  bool changed = store_pixels(values, row(l->south, l, i), m->width);
  if (cut) changed |= store_pixels(values, row(l->south, l, i + 1), m->width);
  return changed;
}

// Divergence of the slopes `g` of row `i`: inflow over its edges minus outflow; `down` is the flow from the row above.
static void right_side(const float *restrict g, const float *restrict east, const float *restrict south, float gx, float gy,
                       float *restrict across, float *restrict down, float *restrict right, ptrdiff_t w) {
  across[0] = across[w] = 0;
  for (ptrdiff_t j = 0; j < w - 1; j++) across[j + 1] = gx * east[j] * (g[2 * j] + g[2 * j + 2]);
  for (ptrdiff_t j = 0; j < w; j++) right[j] = across[j] - across[j + 1] + down[j];
  if (!south) return;
  const float *restrict low = g + 2 * w;
  for (ptrdiff_t j = 0; j < w; j++) {
    down[j] = gy * south[j] * (g[2 * j + 1] + low[2 * j + 1]);
    right[j] -= down[j];
  }
}

// The coarse levels of the couplings that were written to the finest one.
static void build(struct multigrid *grid) {
  for (ptrdiff_t k = 1; k <= grid->levels->height; k++) invert_diagonal(grid->levels, k);
  for (int k = 0; k + 1 < grid->count; k++) coarsen(grid, k);
  invert_coarsest(grid);
  find_islands(grid);
  grid->built = true;
}

// Writes couplings and right side, and builds the coarse levels unless the couplings are those that they were built of.
EXPORT int multigrid_load(struct multigrid *grid, const float *gradients, const float *confidence, const float *anchor, float hx,
                          float hy, ptrdiff_t h, ptrdiff_t w) {
  if (h != grid->height || w != grid->width) return WRONG_SIZE;
  const struct level *l = grid->levels;
  float *none = grid->lines, *east = none + grid->line, *south = east + grid->line, *across = south + grid->line;
  float *down = across + grid->line, *right = down + grid->line;
  bool changed = !grid->built;
  memset(none, 0, w * sizeof *none), memset(down, 0, w * sizeof *down);
  grid->largest = 0;
  for (ptrdiff_t i = 1; i <= h; i++) {
    const float *c = confidence + (i - 1) * w, *g = gradients + (i - 1) * w * 2;
    const ptrdiff_t k = on_finest(i, h);
    couple(c, c + 1, 2 * hy / hx, east, w - 1);
    if (i < h) couple(c, c + w, 2 * hx / hy, south, w);
    right_side(g, east, i < h ? south : NULL, 0.5f * hx, 0.5f * hy, across, down, right, w);
    grid->largest = larger(largest_magnitude(right, w), grid->largest);
    store_right_side(grid, i, right);
    changed |= store_pixels(anchor ? anchor + (i - 1) * w : none, row(l->anchor, l, k), w);
    changed |= store_edges(east, row(l->east, l, k), w);
    if (i < h) changed |= store_edges_down(grid, i, south);
  }
  if (changed) build(grid);
  return OK;
}

// The same of couplings that are given, one for each edge, (h, w - 1) and (h - 1, w), and of a right side that is given.
EXPORT int multigrid_load_edges(struct multigrid *grid, const float *east, const float *south, const float *anchor,
                                const float *right, ptrdiff_t h, ptrdiff_t edges, ptrdiff_t rows, ptrdiff_t w) {
  if (h != grid->height || w != grid->width || edges != w - 1 || rows != h - 1) return WRONG_SIZE;
  const struct level *l = grid->levels;
  for (ptrdiff_t i = 1; i <= h; i++) {
    const ptrdiff_t k = on_finest(i, h);
    store_pixels(anchor + (i - 1) * w, row(l->anchor, l, k), w);
    store_right_side(grid, i, right + (i - 1) * w);
    store_edges(east + (i - 1) * edges, row(l->east, l, k), w);
    if (i < h) memcpy(grid->lines, south + (i - 1) * w, w * sizeof(float)), store_edges_down(grid, i, grid->lines);
  }
  grid->largest = largest_magnitude(right, h * w);
  build(grid);
  return OK;
}
