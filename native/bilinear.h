// A map of large pixels at the places of small ones, bilinearly: both cover the same area, outermost values repeat.
#ifndef GELFORM_BILINEAR_H
#define GELFORM_BILINEAR_H
#include "common.h"

enum { USUAL = 4 };  // small pixels along a large one in most images: loops over as many are vectors, which the compiler knows

// Between which two of `from` values small pixel `at` lies, whose width is `step` of theirs; how far from the first.
static inline ptrdiff_t between(ptrdiff_t at, double step, ptrdiff_t from, float *fraction) {
  const double place = ((double)at + 0.5) * step - 0.5;
  const ptrdiff_t first = place < 0 ? 0 : (ptrdiff_t)place < from - 1 ? (ptrdiff_t)place : from > 1 ? from - 2 : 0;
  const double beyond = place - (double)first;
  *fraction = from < 2 || beyond < 0 ? 0.0f : beyond > 1 ? 1.0f : (float)beyond;
  return first;
}

// A map (r, c) at one of h x w small pixels.
static inline double at_pixel(const float *map, ptrdiff_t y, ptrdiff_t x, ptrdiff_t r, ptrdiff_t c, ptrdiff_t h, ptrdiff_t w) {
  float down, along;
  const ptrdiff_t row = between(y, (double)r / (double)h, r, &down), column = between(x, (double)c / (double)w, c, &along);
  const float *upper = map + row * c + column, *lower = upper + (r > 1 ? c : 0);
  const ptrdiff_t next = c > 1;
  const double above = upper[0] + along * (upper[next] - upper[0]), below = lower[0] + along * (lower[next] - lower[0]);
  return above + down * (below - above);
}

// For each of n small pixels in a row of `from` large ones.
static inline void places_in_row(ptrdiff_t n, double step, ptrdiff_t from, int32_t *first, float *fraction) {
  for (ptrdiff_t j = 0; j < n; j++) first[j] = (int32_t)between(j, step, from, fraction + j);
}

// A row of large pixels at n small ones; `from` is 1 where there is no next value.
static inline void along_row(const float *restrict row, const int32_t *restrict first, const float *restrict fraction, ptrdiff_t from,
                             float *restrict out, ptrdiff_t n) {
  const ptrdiff_t next = from > 1;
  for (ptrdiff_t j = 0; j < n; j++) out[j] = row[first[j]] + fraction[j] * (row[first[j] + next] - row[first[j]]);
}

// Two rows of large pixels, worked out for the small pixels of a row once each.
struct rows_between {
  const float *map;
  ptrdiff_t rows, columns, n, held;  // held: the row that `upper` is of; -1: none
  const int32_t *first;
  const float *fraction;
  float *upper, *lower;
};

static inline void hold_rows(struct rows_between *r, ptrdiff_t row) {
  if (r->held == row) return;
  const bool moved_on = r->held == row - 1 && r->held >= 0;
  float *const taken = r->upper;
  if (moved_on) r->upper = r->lower, r->lower = taken;
  else along_row(r->map + row * r->columns, r->first, r->fraction, r->columns, r->upper, r->n);
  const ptrdiff_t next = row + 1 < r->rows ? row + 1 : row;
  along_row(r->map + next * r->columns, r->first, r->fraction, r->columns, r->lower, r->n);
  r->held = row;
}

#endif
