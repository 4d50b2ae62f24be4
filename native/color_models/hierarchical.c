// Gradients as a polynomial in the color change whose coefficients are given at nodes and bilinear between them.
#include "../background/blurred_change.h"
#include "monomials.h"

struct hierarchical {
  const float *nodes;      // (rows, columns, terms, 2), PIXELS pixels apart
  const int32_t *parents;  // (terms, 2)
  ptrdiff_t rows, columns, terms, w;
  float *line, *planes, *ramps;  // work: (columns, terms, 2), (3, padded), (terms, 4)
};

static ptrdiff_t hierarchical_work(ptrdiff_t columns, ptrdiff_t terms, ptrdiff_t w) {
  return columns * terms * 2 + 3 * padded_width(w) + terms * 4;
}

static void place_work(struct hierarchical *m, float *work) {
  const ptrdiff_t padded = padded_width(m->w);
  m->line = work;
  m->planes = work + m->columns * m->terms * 2;
  m->ramps = m->planes + 3 * padded;
  memset(m->planes, 0, sizeof(float) * 3 * padded);
}

// The coefficients in row y at the nodes' columns around pixels first ... first + count - 1.
static void coefficients_of_row(const struct hierarchical *m, ptrdiff_t y, ptrdiff_t first, ptrdiff_t count) {
  const ptrdiff_t node = y / PIXELS < m->rows - 2 ? y / PIXELS : m->rows - 2, column = m->terms * 2, whole = m->columns * column;
  const ptrdiff_t last = (first + count - 1) / PIXELS + 2, to = (last < m->columns ? last : m->columns) * column;
  const ptrdiff_t beyond = m->columns - 2, from = (first / PIXELS < beyond ? first / PIXELS : beyond) * column;
  const float v = (float)(y - node * PIXELS) / PIXELS;
  const float *restrict above = m->nodes + node * whole, *restrict below = above + whole;
  float *restrict line = m->line;
  for (ptrdiff_t k = from; k < to; k++) line[k] = above[k] + v * (below[k] - above[k]);
}

// Coefficients of the pixels from `start` on: for each term those of p and q at the first pixel, and how much the next node's
// are more.
static void ramps_of_block(const struct hierarchical *m, ptrdiff_t start, float *restrict ramps) {
  const ptrdiff_t last = m->columns - 2, count = m->terms * 2, node = start / PIXELS < last ? start / PIXELS : last;
  const float beyond = (float)(start / PIXELS - node);  // a pixel on the last node has none to its right
  const float *restrict left = m->line + node * count, *restrict right = left + count;
  for (ptrdiff_t k = 0; k < count; k++) {
    const float step = right[k] - left[k];
    ramps[2 * k] = left[k] + beyond * step;
    ramps[2 * k + 1] = step;
  }
}

static const lanes RAMP = {0,      0.0625, 0.125,  0.1875, 0.25,  0.3125, 0.375,  0.4375,
                           0.5,    0.5625, 0.625,  0.6875, 0.75,  0.8125, 0.875,  0.9375};

// Slopes of `count` pixels of row y, the first a node's column, from their color change.
static void slopes_of_row(const struct hierarchical *m, ptrdiff_t y, ptrdiff_t first, ptrdiff_t count, const float *change,
                          float *gradients) {
  const ptrdiff_t stride = padded_width(m->w), terms = m->terms;
  const int32_t *parents = m->parents;
  float *ramps = m->ramps;
  lanes products[MAX_TERMS];
  coefficients_of_row(m, y, first, count);
  planes_of_row(change, m->planes, count, stride);
  for (ptrdiff_t start = 0; start < count; start += PIXELS) {
    lanes p = {0}, q = {0};
    ramps_of_block(m, first + start, ramps);
    for (ptrdiff_t t = 0; t < terms; t++) {
      const lanes product = next_monomial(parents + 2 * t, m->planes + start, stride, products, t);
      const float *ramp = ramps + 4 * t;
      p += product * (ramp[0] + RAMP * ramp[1]);
      q += product * (ramp[2] + RAMP * ramp[3]);
    }
    if (count - start >= PIXELS) store_in_turn(gradients + 2 * start, p, q);
    else row_of_slopes((const float *)&p, (const float *)&q, gradients + 2 * start, count - start);
  }
}

static bool nodes_fit(ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t h, ptrdiff_t w) {
  return rows >= 2 && columns >= 2 && h <= (rows - 1) * PIXELS + 1 && w <= (columns - 1) * PIXELS + 1;
}

EXPORT int hierarchical_gradients(const float *change, const float *nodes, const int32_t *parents, float *work,
                                  float *gradients, ptrdiff_t h, ptrdiff_t w, ptrdiff_t r, ptrdiff_t c, ptrdiff_t t,
                                  ptrdiff_t n) {
  struct hierarchical model = {nodes, parents, r, c, t, w, NULL, NULL, NULL};
  if (!nodes_fit(r, c, h, w) || !monomials_are_ordered(parents, t) || n < hierarchical_work(c, t, w))
    return WRONG_SIZE;
  place_work(&model, work);
  for (ptrdiff_t y = 0; y < h; y++) slopes_of_row(&model, y, 0, w, change + y * 3 * w, gradients + y * 2 * w);
  return OK;
}

// The same in one pass with `color_change`: image -> change and gradients.
EXPORT int hierarchical_from_image(const uint8_t *image, const float *light, const float *scale,
                                   const float *untouched, const float *gain, const float *taps, const float *nodes,
                                   const int32_t *parents, float *work, float *change, float *gradients, ptrdiff_t h,
                                   ptrdiff_t w, ptrdiff_t s, ptrdiff_t k, ptrdiff_t r, ptrdiff_t c, ptrdiff_t t,
                                   ptrdiff_t n) {
  struct blurred_change rows = {image, light, scale, untouched, gain, taps, h, w, k - 1, 0, 0, 0, NULL, NULL, 0};
  struct hierarchical model = {nodes, parents, r, c, t, w, NULL, NULL, NULL};
  const ptrdiff_t own = blurred_change_work(w, rows.radius);
  if (s != 3 * w || !nodes_fit(r, c, h, w) || !monomials_are_ordered(parents, t) ||
      !place_ring(&rows, work, n) || n < own + hierarchical_work(c, t, w))
    return WRONG_SIZE;
  place_work(&model, work + own);
  const ptrdiff_t width = strip_width(&rows);
  for (ptrdiff_t first = 0; first < w; first += width) {
    begin_strip(&rows, first, width);
    for (ptrdiff_t y = 0; y < h; y++) {
      const ptrdiff_t at = y * w + first;
      blurred_change_row(&rows, y, change + 3 * at);
      slopes_of_row(&model, y, first, rows.count, change + 3 * at, gradients + 2 * at);
    }
  }
  return OK;
}
