// The coarsest level: a dense inverse by Gauss-Jordan elimination in double.
#include "grid.h"

enum { ROW = 2 * COARSEST };

static void tie(double *a, ptrdiff_t one, ptrdiff_t other, double coupling) {
  if (coupling == 0) return;
  a[one * ROW + one] += coupling, a[other * ROW + other] += coupling;
  a[one * ROW + other] -= coupling, a[other * ROW + one] -= coupling;
}

// The operator beside the unit matrix; returns its largest diagonal element.
static double fill_matrix(const struct level *l, bool diagonals, double *a) {
  const ptrdiff_t w = l->width, n = l->height * w;
  double largest = 0;
  memset(a, 0, COARSEST * ROW * sizeof *a);
  for (ptrdiff_t k = 0; k < n; k++) {
    const ptrdiff_t place = (1 + k / w) * l->stride + 1 + k % w;
    a[k * ROW + k] += larger(l->anchor[place], 0);
    a[k * ROW + n + k] = 1;
    tie(a, k, k + 1, l->east[place]);
    tie(a, k, k + w, l->south[place]);
    if (diagonals) tie(a, k, k + w + 1, l->southeast[place]), tie(a, k, k + w - 1, l->southwest[place]);
    if (a[k * ROW + k] > largest) largest = a[k * ROW + k];
  }
  return largest;
}

// Pixels tied to no anchor have no absolute height: the last pivot among them is 0, and it stays at 0.
static void eliminate(double *a, ptrdiff_t n, double largest) {
  for (ptrdiff_t pivot = 0; pivot < n; pivot++) {
    const double value = a[pivot * ROW + pivot], scale = value > 1e-9 * largest ? 1 / value : 0;
    for (ptrdiff_t j = pivot; j < 2 * n; j++) a[pivot * ROW + j] *= scale;
    for (ptrdiff_t i = 0; i < n; i++) {
      const double factor = a[i * ROW + pivot];
      if (i == pivot || factor == 0) continue;
      INDEPENDENT for (ptrdiff_t j = pivot; j < 2 * n; j++) a[i * ROW + j] -= factor * a[pivot * ROW + j];
    }
  }
}

void invert_coarsest(const struct multigrid *m) {
  const struct level *l = coarsest(m);
  const ptrdiff_t n = l->height * l->width;
  eliminate(m->elimination, n, fill_matrix(l, m->count > 1, m->elimination));
  for (ptrdiff_t i = 0; i < n; i++)
    for (ptrdiff_t j = 0; j < n; j++) m->dense[i * COARSEST + j] = (float)m->elimination[i * ROW + n + j];
}

// Its answer to its right side; returns their product.
double solve_coarsest(const struct multigrid *m) {
  const struct level *l = coarsest(m);
  const ptrdiff_t n = l->height * l->width, w = l->width;
  float right[COARSEST];
  double product = 0;
  for (ptrdiff_t k = 0; k < n; k++) right[k] = l->right[(1 + k / w) * l->stride + 1 + k % w];
  for (ptrdiff_t k = 0; k < n; k++) {
    const float value = dot(m->dense + k * COARSEST, right, n);
    l->answer[(1 + k / w) * l->stride + 1 + k % w] = value;
    product += (double)value * right[k];
  }
  return product;
}
