// Unknown pixels from a pyramid of averages of known ones.
#include "../common.h"

// Mean of the known among 2x2 pixels of c channels, at row i and column j of the coarser level; whether any is.
static bool mean_of_known(const float *values, const bool *known, float *mean, ptrdiff_t i, ptrdiff_t j, ptrdiff_t h,
                          ptrdiff_t w, ptrdiff_t c) {
  float count = 0;
  for (ptrdiff_t y = 2 * i; y < h && y < 2 * i + 2; y++)
    for (ptrdiff_t x = 2 * j; x < w && x < 2 * j + 2; x++) count += known[y * w + x];
  for (ptrdiff_t k = 0; k < c; k++) mean[k] = 0;
  if (count == 0) return false;
  for (ptrdiff_t y = 2 * i; y < h && y < 2 * i + 2; y++)
    for (ptrdiff_t x = 2 * j; x < w && x < 2 * j + 2; x++)
      for (ptrdiff_t k = 0; k < c; k++) mean[k] += (float)known[y * w + x] / count * values[(y * w + x) * c + k];
  return true;
}

EXPORT int coarser_known(const float *values, const bool *known, float *coarse, bool *coarse_known, ptrdiff_t h,
                         ptrdiff_t w, ptrdiff_t c, ptrdiff_t rows, ptrdiff_t columns) {
  if (rows != (h + 1) / 2 || columns != (w + 1) / 2) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < rows; i++)
    for (ptrdiff_t j = 0; j < columns; j++)
      coarse_known[i * columns + j] =
          mean_of_known(values, known, coarse + (i * columns + j) * c, i, j, h, w, c);
  return OK;
}

// The nearest coarse row or column of a pixel, and the next nearest.
static inline ptrdiff_t next_nearest(ptrdiff_t pixel, ptrdiff_t count) {
  const ptrdiff_t next = pixel / 2 + 2 * (pixel % 2) - 1;
  return next < 0 ? 0 : next > count - 1 ? count - 1 : next;
}

static void interpolate(const float *coarse, float *values, ptrdiff_t i, ptrdiff_t j, ptrdiff_t rows,
                        ptrdiff_t columns, ptrdiff_t c) {
  const float *near = coarse + i / 2 * columns * c, *far = coarse + next_nearest(i, rows) * columns * c;
  const ptrdiff_t left = j / 2 * c, right = next_nearest(j, columns) * c;
  for (ptrdiff_t k = 0; k < c; k++) {
    const float on_near = 0.75f * near[left + k] + 0.25f * near[right + k];
    const float on_far = 0.75f * far[left + k] + 0.25f * far[right + k];
    values[k] = 0.75f * on_near + 0.25f * on_far;
  }
}

// A pixel becomes the mean of its neighbors, of those that the frame has.
static void relax(float *values, ptrdiff_t i, ptrdiff_t j, ptrdiff_t h, ptrdiff_t w, ptrdiff_t c) {
  const float neighbors = (float)((i > 0) + (i < h - 1) + (j > 0) + (j < w - 1));
  if (neighbors == 0) return;
  for (ptrdiff_t k = 0; k < c; k++) {
    const float *here = values + (i * w + j) * c + k;
    float total = 0;
    if (i > 0) total += here[-w * c];
    if (i < h - 1) total += here[w * c];
    if (j > 0) total += here[-c];
    if (j < w - 1) total += here[c];
    values[(i * w + j) * c + k] = total / neighbors;
  }
}

// Unknown pixels from the coarser level, bilinearly; then relaxed `sweeps` times, forwards and backwards in turn.
EXPORT int fill_from_coarser(const float *coarse, float *values, const bool *known, int32_t sweeps, ptrdiff_t rows,
                             ptrdiff_t columns, ptrdiff_t c, ptrdiff_t h, ptrdiff_t w) {
  if (rows != (h + 1) / 2 || columns != (w + 1) / 2) return WRONG_SIZE;
  for (ptrdiff_t n = 0; n < h * w; n++)
    if (!known[n]) interpolate(coarse, values + n * c, n / w, n % w, rows, columns, c);
  for (int32_t sweep = 0; sweep < sweeps; sweep++)
    for (ptrdiff_t step = 0; step < h * w; step++) {
      const ptrdiff_t n = sweep % 2 == 0 ? step : h * w - 1 - step;
      if (!known[n]) relax(values, n / w, n % w, h, w, c);
    }
  return OK;
}
