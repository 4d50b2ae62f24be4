// Monomials of a color, each from one of lower degree: (r, g, b, r r, r g, ...).
#ifndef GELFORM_MONOMIALS_H
#define GELFORM_MONOMIALS_H
#include "../../common.h"

enum { PIXELS = LANES, MAX_TERMS = 64 };  // PIXELS: of one row at a time, so that sums stay in registers

// One row of a color change (w, 3) as three planes (3, stride).
static inline void planes_of_row(const float *restrict change, float *restrict planes, ptrdiff_t w, ptrdiff_t stride) {
  for (ptrdiff_t x = 0; x < w; x++) {
    planes[x] = change[3 * x];
    planes[stride + x] = change[3 * x + 1];
    planes[2 * stride + x] = change[3 * x + 2];
  }
}

static inline void row_of_slopes(const float *restrict p, const float *restrict q, float *restrict gradients,
                                 ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++) {
    gradients[2 * x] = p[x];
    gradients[2 * x + 1] = q[x];
  }
}

// products[t], a color channel times the product of its parent, (parent, channel); a parent of -1 is 1.
static inline lanes next_monomial(const int32_t *parent, const float *planes, ptrdiff_t stride, lanes *products, ptrdiff_t t) {
  const lanes channel = load_lanes(planes + parent[1] * stride);
  return products[t] = parent[0] < 0 ? channel : products[parent[0]] * channel;
}

// Terms follow their parents, and each channel is one of three.
static inline bool monomials_are_ordered(const int32_t *parents, ptrdiff_t count) {
  if (count > MAX_TERMS) return false;
  for (ptrdiff_t t = 0; t < count; t++)
    if (parents[2 * t] >= t || parents[2 * t + 1] < 0 || parents[2 * t + 1] > 2) return false;
  return true;
}

static inline ptrdiff_t padded_width(ptrdiff_t w) { return (w + PIXELS - 1) / PIXELS * PIXELS; }

#endif
