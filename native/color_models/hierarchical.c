// Gradients as a polynomial in the color change whose coefficients are given at nodes and bilinear between them.
#include "../background/blurred_change.h"
#include "monomials.h"

struct hierarchical {
  const float *nodes;      // (rows, columns, terms, 2), PIXELS pixels apart
  const int32_t *parents;  // (terms, 2)
  ptrdiff_t rows, columns, terms, w;
  float *line, *planes, *p, *q;  // work: (columns, terms, 2), (3, padded), (padded), (padded)
};

static ptrdiff_t hierarchical_work(ptrdiff_t columns, ptrdiff_t terms, ptrdiff_t w) {
  return columns * terms * 2 + 5 * padded_width(w);
}

static void place_work(struct hierarchical *m, float *work) {
  const ptrdiff_t padded = padded_width(m->w);
  m->line = work;
  m->planes = work + m->columns * m->terms * 2;
  m->p = m->planes + 3 * padded;
  m->q = m->p + padded;
  memset(m->planes, 0, sizeof(float) * 5 * padded);
}

// The coefficients at the nodes' columns in row y.
static void coefficients_of_row(const struct hierarchical *m, ptrdiff_t y) {
  const ptrdiff_t node = y / PIXELS < m->rows - 2 ? y / PIXELS : m->rows - 2, count = m->columns * m->terms * 2;
  const float v = (float)(y - node * PIXELS) / PIXELS;
  const float *restrict above = m->nodes + node * count, *restrict below = above + count;
  float *restrict line = m->line;
  for (ptrdiff_t k = 0; k < count; k++) line[k] = above[k] + v * (below[k] - above[k]);
}

static const float RAMP[PIXELS] = {0,      0.0625, 0.125,  0.1875, 0.25,  0.3125, 0.375,  0.4375,
                                   0.5,    0.5625, 0.625,  0.6875, 0.75,  0.8125, 0.875,  0.9375};

// p, q += product (start + ramp step), of PIXELS pixels.
static inline void add_term(const float *restrict product, const float *restrict left, const float *restrict right,
                            float beyond, float *restrict p, float *restrict q) {
  const float p_step = right[0] - left[0], q_step = right[1] - left[1];
  const float p_start = left[0] + beyond * p_step, q_start = left[1] + beyond * q_step;
  for (int k = 0; k < PIXELS; k++) {
    p[k] += product[k] * (p_start + RAMP[k] * p_step);
    q[k] += product[k] * (q_start + RAMP[k] * q_step);
  }
}

// Slopes of row y from its color change (w, 3).
static void slopes_of_row(const struct hierarchical *m, ptrdiff_t y, const float *change, float *gradients) {
  const ptrdiff_t stride = padded_width(m->w), last = m->columns - 2, count = m->terms * 2;
  float products[MAX_TERMS][PIXELS];
  coefficients_of_row(m, y);
  planes_of_row(change, m->planes, m->w, stride);
  for (ptrdiff_t start = 0; start < m->w; start += PIXELS) {
    const ptrdiff_t node = start / PIXELS < last ? start / PIXELS : last;
    const float *left = m->line + node * count, *right = left + count;
    const float beyond = (float)(start / PIXELS - node);  // a pixel on the last node has none to its right
    float p[PIXELS] = {0}, q[PIXELS] = {0};
    for (ptrdiff_t t = 0; t < m->terms; t++) {
      next_monomial(m->parents + 2 * t, m->planes + start, stride, products, t);
      add_term(products[t], left + 2 * t, right + 2 * t, beyond, p, q);
    }
    memcpy(m->p + start, p, sizeof p);
    memcpy(m->q + start, q, sizeof q);
  }
  row_of_slopes(m->p, m->q, gradients, m->w);
}

static bool nodes_fit(ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t h, ptrdiff_t w) {
  return rows >= 2 && columns >= 2 && h <= (rows - 1) * PIXELS + 1 && w <= (columns - 1) * PIXELS + 1;
}

EXPORT int hierarchical_gradients(const float *change, const float *nodes, const int32_t *parents, float *work,
                                  float *gradients, ptrdiff_t h, ptrdiff_t w, ptrdiff_t r, ptrdiff_t c, ptrdiff_t t,
                                  ptrdiff_t n) {
  struct hierarchical model = {nodes, parents, r, c, t, w, NULL, NULL, NULL, NULL};
  if (!nodes_fit(r, c, h, w) || !monomials_are_ordered(parents, t) || n < hierarchical_work(c, t, w))
    return WRONG_SIZE;
  place_work(&model, work);
  for (ptrdiff_t y = 0; y < h; y++) slopes_of_row(&model, y, change + y * 3 * w, gradients + y * 2 * w);
  return OK;
}

// The same in one pass with `color_change`: image -> change and gradients.
EXPORT int hierarchical_from_image(const uint8_t *image, const float *light, const float *scale,
                                   const float *untouched, const float *gain, const float *taps, const float *nodes,
                                   const int32_t *parents, float *work, float *change, float *gradients, ptrdiff_t h,
                                   ptrdiff_t w, ptrdiff_t s, ptrdiff_t k, ptrdiff_t r, ptrdiff_t c, ptrdiff_t t,
                                   ptrdiff_t n) {
  struct blurred_change rows = {image, light, scale, untouched, gain, taps, h, 3 * w, k - 1, 0, work, NULL};
  struct hierarchical model = {nodes, parents, r, c, t, w, NULL, NULL, NULL, NULL};
  const ptrdiff_t own = blurred_change_work(3 * w, rows.radius);
  if (s != 3 * w || !nodes_fit(r, c, h, w) || !monomials_are_ordered(parents, t) ||
      n < own + hierarchical_work(c, t, w))
    return WRONG_SIZE;
  rows.ring = work + 3 * w + 6 * rows.radius;
  place_work(&model, work + own);
  for (ptrdiff_t y = 0; y < h; y++) {
    blurred_change_row(&rows, y, change + y * 3 * w);
    slopes_of_row(&model, y, change + y * 3 * w, gradients + y * 2 * w);
  }
  return OK;
}
