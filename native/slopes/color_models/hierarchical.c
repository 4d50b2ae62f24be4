// Gradients as a polynomial in the color change whose coefficients are given at nodes and bilinear between them.
#include "../../image/background/blurred_change.h"
#include "nodes.h"

struct hierarchical {
  struct node_grid grid;   // of coefficients (terms, 2)
  const int32_t *parents;  // (terms, 2)
  ptrdiff_t terms, w;
  float *planes;  // work: (3, padded)
};

static ptrdiff_t hierarchical_work(ptrdiff_t columns, ptrdiff_t terms, ptrdiff_t w) {
  return node_work(columns, 2 * terms) + 3 * padded_width(w);
}

static void place_work(struct hierarchical *m, float *work) {
  m->grid.line = work;
  m->grid.ramps = work + m->grid.columns * m->grid.count;
  m->planes = m->grid.ramps + 2 * m->grid.count;
  memset(m->planes, 0, sizeof(float) * 3 * padded_width(m->w));
}

// Slopes of `count` pixels of row y, the first a node's column, from their color change. Whether one has a component over `most`.
static bool slopes_of_row(const struct hierarchical *m, ptrdiff_t y, ptrdiff_t first, ptrdiff_t count, const float *change,
                          float most, float *gradients) {
  const ptrdiff_t stride = padded_width(m->w), terms = m->terms;
  const int32_t *parents = m->parents;
  const lanes along = along_block();
  lanes products[MAX_TERMS];
  coefficients_of_row(&m->grid, y, first, count);
  planes_of_row(change, m->planes, count, stride);
  for (ptrdiff_t start = 0; start < count; start += PIXELS) {
    lanes p = {0}, q = {0};
    const float *ramps = ramps_of_block(&m->grid, first + start);
    for (ptrdiff_t t = 0; t < terms; t++) {
      const lanes product = next_monomial(parents + 2 * t, m->planes + start, stride, products, t);
      const float *ramp = ramps + 4 * t;
      p += product * (ramp[0] + along * ramp[1]);
      q += product * (ramp[2] + along * ramp[3]);
    }
    if (count - start >= PIXELS) store_in_turn(gradients + 2 * start, p, q);
    else row_of_slopes((const float *)&p, (const float *)&q, gradients + 2 * start, count - start);
  }
  return largest_magnitude(gradients, 2 * count) > most;
}

EXPORT int hierarchical_gradients(const float *change, const float *nodes, const int32_t *parents, float *work,
                                  float *gradients, float most, ptrdiff_t h, ptrdiff_t w, ptrdiff_t r, ptrdiff_t c, ptrdiff_t t,
                                  ptrdiff_t n) {
  struct hierarchical model = {{nodes, r, c, 2 * t, NULL, NULL}, parents, t, w, NULL};
  if (!nodes_fit(r, c, h, w) || !monomials_are_ordered(parents, t) || n < hierarchical_work(c, t, w))
    return WRONG_SIZE;
  place_work(&model, work);
  bool beyond = false;
  for (ptrdiff_t y = 0; y < h; y++) beyond |= slopes_of_row(&model, y, 0, w, change + y * 3 * w, most, gradients + y * 2 * w);
  return beyond;
}

// The same in one pass with `color_change`: image -> change and gradients.
EXPORT int hierarchical_from_image(const uint8_t *image, const float *light, const float *scale,
                                   const float *untouched, const float *gain, const float *taps, const float *nodes,
                                   const int32_t *parents, float *work, float *change, float *gradients, float most, ptrdiff_t h,
                                   ptrdiff_t w, ptrdiff_t s, ptrdiff_t k, ptrdiff_t r, ptrdiff_t c, ptrdiff_t t,
                                   ptrdiff_t n) {
  struct blurred_change rows = {image, light, scale, s, untouched, gain, taps, h, w, k - 1, 0, 0, 0, NULL, NULL, 0};
  struct hierarchical model = {{nodes, r, c, 2 * t, NULL, NULL}, parents, t, w, NULL};
  const ptrdiff_t own = blurred_change_work(w, rows.radius);
  if (!is_light(s, h, w) || !nodes_fit(r, c, h, w) || !monomials_are_ordered(parents, t) ||
      !place_ring(&rows, work, n) || n < own + hierarchical_work(c, t, w))
    return WRONG_SIZE;
  place_work(&model, work + own);
  const ptrdiff_t width = strip_width(&rows);
  bool beyond = false;
  for (ptrdiff_t first = 0; first < w; first += width) {
    begin_strip(&rows, first, width);
    for (ptrdiff_t y = 0; y < h; y++) {
      const ptrdiff_t at = y * w + first;
      blurred_change_row(&rows, y, change + 3 * at);
      beyond |= slopes_of_row(&model, y, first, rows.count, change + 3 * at, most, gradients + 2 * at);
    }
  }
  return beyond;
}
