// The row below which a frame belongs to another moment: there alone, its change from rest steps from one row to the next.
#include "steps.h"

// Twice the step of the change from rest at one place that the rows around it do not explain: between the lines through
// the two rows on either side, of one slope. A step of 1 from one row to the next gives 2 there and -1 at the rows beside it.
static inline float step_at(const uint16_t *sums, const uint16_t *rest, ptrdiff_t i, ptrdiff_t n) {
  const int32_t before = sums[i - n] - rest[i - n], after = sums[i] - rest[i];
  return (float)(3 * (after - before) - (sums[i + n] - rest[i + n]) + (sums[i - 2 * n] - rest[i - 2 * n]));
}

// The row that begins with a step; 0: none does. `sums` (h, n) are those of a frame, `rest` those of the background image.
// Squared steps count relative to their mean in the same column, at least `least` squared, and are added up over a row.
// `totals` (h): of each row, with the step taken out. The step must be `factor` times the largest of them, and the two rows
// on either side must not hold `spill` of it, as they do of an edge, which optics blur.
EXPORT int health_seam(const uint16_t *sums, const uint16_t *rest, float *work, float *totals, float least, float factor,
                       float spill, ptrdiff_t h, ptrdiff_t n, ptrdiff_t m) {
  if (m != 3 * n) return WRONG_SIZE;
  float *restrict weights = work, *restrict row = work + n, *restrict seam = work + 2 * n;
  for (ptrdiff_t i = 0; i < n; i++) weights[i] = 0;
  for (ptrdiff_t y = 2; y + 1 < h; y++)
    for (ptrdiff_t i = 0; i < n; i++) {
      const float step = step_at(sums, rest, y * n + i, n);
      weights[i] += step * step;
    }
  for (ptrdiff_t i = 0; i < n; i++) {
    const float usual = weights[i] / (float)h;
    weights[i] = 1 / (usual > least * least ? usual : least * least);
  }
  ptrdiff_t top = 0;
  for (ptrdiff_t y = 0; y < h; y++) {
    const bool inside = y >= 2 && y + 1 < h;
    for (ptrdiff_t i = 0; i < n && inside; i++) {
      const float step = step_at(sums, rest, y * n + i, n);
      row[i] = step * step;
    }
    totals[y] = inside ? dot(row, weights, n) : 0;
    top = totals[y] > totals[top] ? y : top;
  }
  if (top == 0) return 0;
  const float largest = totals[top];
  float held = 0;
  for (ptrdiff_t i = 0; i < n; i++) seam[i] = step_at(sums, rest, top * n + i, n);
  for (ptrdiff_t y = top > 4 ? top - 2 : 2; y <= top + 2 && y + 1 < h; y++) {
    const float of_step = y == top ? -1 : y == top - 1 || y == top + 1 ? .5f : 0;
    for (ptrdiff_t i = 0; i < n; i++) row[i] = (step_at(sums, rest, y * n + i, n) + of_step * seam[i]) * seam[i];
    const float part = fabsf(dot(row, weights, n)) / largest;
    held = part > held ? part : held;
    for (ptrdiff_t i = 0; i < n; i++) row[i] = step_at(sums, rest, y * n + i, n) + of_step * seam[i];
    for (ptrdiff_t i = 0; i < n; i++) row[i] *= row[i];
    totals[y] = dot(row, weights, n);
  }
  float others = (float)n;
  for (ptrdiff_t y = 0; y < h; y++) others = totals[y] > others ? totals[y] : others;
  return largest > factor * others && held < spill ? (int)top : 0;
}

enum { THIRDS = 3, CUBIC = 4, STRIP = 16 };  // terms of a cubic along the rows; px, a strip that sums are over

// What the rows' gray levels in the left, middle and right third of a frame have in common, beyond the background image's and a smooth
// change: the least mean product of two thirds. `gray` (h, 3): the background's levels; `smooth` (h, 4): orthonormal.
EXPORT int health_bands(const uint16_t *sums, const float *gray, const float *smooth, float *flat, float *common, ptrdiff_t h,
                        ptrdiff_t n) {
  const ptrdiff_t each = n / THIRDS;
  if (each < 1) return WRONG_SIZE;
  double all = 0, usual = 0, products[THIRDS] = {0};
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t t = 0; t < THIRDS; t++) {
      int64_t total = 0;
      for (ptrdiff_t i = 0; i < 3 * each; i++) total += sums[3 * (y * n + t * each) + i];
      flat[THIRDS * y + t] = (float)total / (float)(3 * STRIP * each);
      all += (double)flat[THIRDS * y + t], usual += (double)gray[THIRDS * y + t];
    }
  const double least = (double)(THIRDS * h), gain = usual / (all > least ? all : least);
  for (ptrdiff_t t = 0; t < THIRDS; t++) {
    double terms[CUBIC] = {0};
    for (ptrdiff_t y = 0; y < h; y++) {
      float *one = flat + THIRDS * y + t;
      *one = (float)(gain * (double)*one) - gray[THIRDS * y + t];
      for (int k = 0; k < CUBIC; k++) terms[k] += (double)(smooth[CUBIC * y + k] * *one);
    }
    for (ptrdiff_t y = 0; y < h; y++)
      for (int k = 0; k < CUBIC; k++) flat[THIRDS * y + t] -= smooth[CUBIC * y + k] * (float)terms[k];
  }
  for (ptrdiff_t y = 0; y < h; y++)
    for (int t = 0; t < THIRDS; t++) products[t] += (double)(flat[THIRDS * y + t] * flat[THIRDS * y + (t + 1) % THIRDS]);
  for (int t = 1; t < THIRDS; t++) products[0] = products[t] < products[0] ? products[t] : products[0];
  *common = (float)(products[0] / (double)h);
  return OK;
}
