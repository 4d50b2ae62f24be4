// Moments of labeled regions: what area, centroid, axes, volume and deepest point follow from.
#include "../common.h"

enum { COUNT, SUM_X, SUM_Y, SUM_XX, SUM_XY, SUM_YY, SUM_Z, MAX_Z, X_OF_MAX, Y_OF_MAX, MIN_X, MAX_X, MIN_Y, MAX_Y, FIGURES };

// 0 + 1 + 4 + ... + (n - 1)^2
static inline int64_t squares_below(int64_t n) { return (n - 1) * n * (2 * n - 1) / 6; }

// Depths are added in the order of the pixels; of the deepest the first counts.
static inline void take_in_depths(double *of, const float *depth, ptrdiff_t first, ptrdiff_t end, ptrdiff_t y) {
  double total = of[SUM_Z], most = of[COUNT] == 0 ? -INFINITY : of[MAX_Z];
  ptrdiff_t deepest = -1;
  for (ptrdiff_t x = first; x < end; x++) {
    total += depth[x];
    if (depth[x] > most) most = depth[x], deepest = x;
  }
  of[SUM_Z] = total, of[MAX_Z] = most;
  if (deepest >= 0) of[X_OF_MAX] = (double)deepest, of[Y_OF_MAX] = (double)y;
}

// A run of a region's pixels in row y. Whole numbers add up exactly in doubles.
static inline void take_in(double *of, const float *depth, ptrdiff_t first, ptrdiff_t end, ptrdiff_t y) {
  const int64_t count = end - first, sum = (first + end - 1) * count / 2;
  take_in_depths(of, depth, first, end, y);
  if (of[COUNT] == 0) of[MIN_X] = (double)first, of[MAX_X] = (double)(end - 1), of[MIN_Y] = (double)y;
  of[COUNT] += (double)count;
  of[SUM_X] += (double)sum, of[SUM_Y] += (double)(y * count);
  of[SUM_XX] += (double)(squares_below(end) - squares_below(first));
  of[SUM_XY] += (double)(sum * y), of[SUM_YY] += (double)(y * y * count);
  of[MIN_X] = (double)first < of[MIN_X] ? (double)first : of[MIN_X];
  of[MAX_X] = (double)(end - 1) > of[MAX_X] ? (double)(end - 1) : of[MAX_X];
  of[MAX_Y] = (double)y;
}

// The first pixel from x on that is of a region; whole words of pixels that are not are passed by.
static inline ptrdiff_t next_labeled(const uint16_t *row, ptrdiff_t x, ptrdiff_t w) {
  for (uint64_t word; x + 4 <= w; x += 4) {
    memcpy(&word, row + x, sizeof word);
    if (word != 0) break;
  }
  while (x < w && row[x] == 0) x++;
  return x;
}

// Labels are 1 ... n; 0 is no region. `moments` (n, FIGURES) is set, not added to.
EXPORT int region_moments(const uint16_t *labels, const float *depth, double *moments, ptrdiff_t h, ptrdiff_t w,
                          ptrdiff_t n) {
  memset(moments, 0, (size_t)n * FIGURES * sizeof *moments);
  for (ptrdiff_t y = 0; y < h; y++) {
    const uint16_t *row = labels + y * w;
    for (ptrdiff_t x = next_labeled(row, 0, w), end; x < w; x = next_labeled(row, end, w)) {
      if (row[x] > n) return WRONG_SIZE;
      for (end = x + 1; end < w && row[end] == row[x];) end++;
      take_in(moments + (row[x] - 1) * FIGURES, depth + y * w, x, end, y);
    }
  }
  return OK;
}
