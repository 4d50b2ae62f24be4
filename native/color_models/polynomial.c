// Gradients as a polynomial in the color change whose coefficients are polynomials in the place.
#include "monomials.h"

// Both coefficients of a term, Horner in x: a (columns), b (columns), of degree `degree`; then p, q += product times them.
static inline void add_term(const float *restrict product, const float *restrict a, const float *restrict b,
                            int32_t degree, const float *restrict x, float *restrict p, float *restrict q) {
  float pa[PIXELS], qb[PIXELS];
  for (int k = 0; k < PIXELS; k++) pa[k] = a[degree], qb[k] = b[degree];
  for (int32_t i = degree - 1; i >= 0; i--)
    for (int k = 0; k < PIXELS; k++) pa[k] = pa[k] * x[k] + a[i], qb[k] = qb[k] * x[k] + b[i];
  for (int k = 0; k < PIXELS; k++) p[k] += product[k] * pa[k], q[k] += product[k] * qb[k];
}

// Each row has its own coefficients, (2, terms, columns): what depends on y is worked out beforehand.
EXPORT int polynomial_gradients(const float *change, const float *x, const float *table, const int32_t *degrees,
                                const int32_t *parents, float *work, float *gradients, ptrdiff_t h, ptrdiff_t w,
                                ptrdiff_t t, ptrdiff_t c, ptrdiff_t n) {
  const ptrdiff_t stride = padded_width(w);
  if (!monomials_are_ordered(parents, t) || n < 6 * stride) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < t; k++)
    if (degrees[k] < 0 || degrees[k] >= c) return WRONG_SIZE;
  float products[MAX_TERMS][PIXELS], *planes = work, *xs = work + 3 * stride, *ps = xs + stride, *qs = ps + stride;
  memset(work, 0, sizeof(float) * 6 * stride);
  memcpy(xs, x, sizeof(float) * w);
  for (ptrdiff_t y = 0; y < h; y++) {
    const float *a = table + y * 2 * t * c, *b = a + t * c;
    planes_of_row(change + y * 3 * w, planes, w, stride);
    for (ptrdiff_t start = 0; start < w; start += PIXELS) {
      float p[PIXELS] = {0}, q[PIXELS] = {0};
      for (ptrdiff_t k = 0; k < t; k++) {
        next_monomial(parents + 2 * k, planes + start, stride, products, k);
        add_term(products[k], a + k * c, b + k * c, degrees[k], xs + start, p, q);
      }
      memcpy(ps + start, p, sizeof p);
      memcpy(qs + start, q, sizeof q);
    }
    row_of_slopes(ps, qs, gradients + y * 2 * w, w);
  }
  return OK;
}
