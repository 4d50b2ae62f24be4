// Gradients as a polynomial in the color change whose coefficients are polynomials in the place.
#include "monomials.h"

// A polynomial in x, by Horner's rule.
static inline lanes at_place(const float *a, int32_t degree, lanes x) {
  lanes value = a[degree] + (lanes){0};
  for (int32_t i = degree - 1; i >= 0; i--) value = value * x + a[i];
  return value;
}

// Each row has its own coefficients, (2, terms, columns): what depends on y is worked out beforehand.
EXPORT int polynomial_gradients(const float *change, const float *x, const float *table, const int32_t *degrees,
                                const int32_t *parents, float *work, float *gradients, ptrdiff_t h, ptrdiff_t w,
                                ptrdiff_t t, ptrdiff_t c, ptrdiff_t n) {
  const ptrdiff_t stride = padded_width(w);
  if (!monomials_are_ordered(parents, t) || n < 6 * stride) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < t; k++)
    if (degrees[k] < 0 || degrees[k] >= c) return WRONG_SIZE;
  float *planes = work, *xs = work + 3 * stride, *ps = xs + stride, *qs = ps + stride;
  lanes products[MAX_TERMS];
  memset(work, 0, sizeof(float) * 6 * stride);
  memcpy(xs, x, sizeof(float) * w);
  for (ptrdiff_t y = 0; y < h; y++) {
    const float *a = table + y * 2 * t * c, *b = a + t * c;
    planes_of_row(change + y * 3 * w, planes, w, stride);
    for (ptrdiff_t start = 0; start < w; start += PIXELS) {
      const lanes place = load_lanes(xs + start);
      lanes p = {0}, q = {0};
      for (ptrdiff_t k = 0; k < t; k++) {
        const lanes product = next_monomial(parents + 2 * k, planes + start, stride, products, k);
        p += product * at_place(a + k * c, degrees[k], place);
        q += product * at_place(b + k * c, degrees[k], place);
      }
      store_lanes(ps + start, p);
      store_lanes(qs + start, q);
    }
    row_of_slopes(ps, qs, gradients + y * 2 * w, w);
  }
  return OK;
}
