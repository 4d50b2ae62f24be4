// Coefficients that are given at nodes, PIXELS pixels apart, and bilinear between them.
#ifndef GELFORM_NODES_H
#define GELFORM_NODES_H
#include "monomials.h"

struct node_grid {
  const float *nodes;             // (rows, columns, count)
  ptrdiff_t rows, columns, count; // count: coefficients of a node
  float *line, *ramps;            // work: (columns, count), (count, 2)
};

static inline ptrdiff_t node_work(ptrdiff_t columns, ptrdiff_t count) { return columns * count + 2 * count; }

static inline bool nodes_fit(ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t h, ptrdiff_t w) {
  return rows >= 2 && columns >= 2 && h <= (rows - 1) * PIXELS + 1 && w <= (columns - 1) * PIXELS + 1;
}

// The coefficients in row y at the nodes' columns around pixels first ... first + count - 1.
static inline void coefficients_of_row(const struct node_grid *g, ptrdiff_t y, ptrdiff_t first, ptrdiff_t count) {
  const ptrdiff_t node = y / PIXELS < g->rows - 2 ? y / PIXELS : g->rows - 2, whole = g->columns * g->count;
  const ptrdiff_t last = (first + count - 1) / PIXELS + 2, to = (last < g->columns ? last : g->columns) * g->count;
  const ptrdiff_t beyond = g->columns - 2, from = (first / PIXELS < beyond ? first / PIXELS : beyond) * g->count;
  const float v = (float)(y - node * PIXELS) / PIXELS;
  const float *restrict above = g->nodes + node * whole, *restrict below = above + whole;
  float *restrict line = g->line;
  for (ptrdiff_t k = from; k < to; k++) line[k] = above[k] + v * (below[k] - above[k]);
}

// Coefficients of the pixels from `start` on: each one at the first pixel, and how much the next node's is more.
static inline const float *ramps_of_block(const struct node_grid *g, ptrdiff_t start) {
  const ptrdiff_t last = g->columns - 2, node = start / PIXELS < last ? start / PIXELS : last;
  const float beyond = (float)(start / PIXELS - node);  // a pixel on the last node has none to its right
  const float *restrict left = g->line + node * g->count, *restrict right = left + g->count;
  float *restrict ramps = g->ramps;
  for (ptrdiff_t k = 0; k < g->count; k++) {
    const float step = right[k] - left[k];
    ramps[2 * k] = left[k] + beyond * step;
    ramps[2 * k + 1] = step;
  }
  return g->ramps;
}

// For kernels of many coefficients, in place of `ramps_of_block`: how much more each of the row's is at the next node; 0 at
// the last one, where a block has one pixel, on the node. Of the block at `start`: line and steps + start / PIXELS * count.
static inline void steps_of_row(const struct node_grid *g, float *restrict steps) {
  const ptrdiff_t inner = (g->columns - 1) * g->count;
  const float *restrict line = g->line;
  for (ptrdiff_t k = 0; k < inner; k++) steps[k] = line[k + g->count] - line[k];
  memset(steps + inner, 0, sizeof(float) * (size_t)g->count);
}

// How far each pixel of a block is on its way to the next node; the compiler makes a constant of it.
static inline lanes along_block(void) {
  lanes along;
  for (int k = 0; k < LANES; k++) along[k] = (float)k / PIXELS;
  return along;
}

#endif
