// Moments of labelled regions: what area, centroid, axes, volume and deepest point follow from.
#include "../common.h"

enum { COUNT, SUM_X, SUM_Y, SUM_XX, SUM_XY, SUM_YY, SUM_Z, MAX_Z, X_OF_MAX, Y_OF_MAX, MIN_X, MAX_X, MIN_Y, MAX_Y, FIGURES };

// Whole numbers add up exactly in doubles; depths are added in the order of the pixels.
static inline void take_in(double *of, ptrdiff_t x, ptrdiff_t y, double z) {
  if (of[COUNT] == 0 || z > of[MAX_Z]) of[MAX_Z] = z, of[X_OF_MAX] = (double)x, of[Y_OF_MAX] = (double)y;
  if (of[COUNT] == 0) of[MIN_X] = of[MAX_X] = (double)x, of[MIN_Y] = (double)y;
  of[COUNT] += 1;
  of[SUM_X] += (double)x, of[SUM_Y] += (double)y, of[SUM_Z] += z;
  of[SUM_XX] += (double)(x * x), of[SUM_XY] += (double)(x * y), of[SUM_YY] += (double)(y * y);
  of[MIN_X] = (double)x < of[MIN_X] ? (double)x : of[MIN_X];
  of[MAX_X] = (double)x > of[MAX_X] ? (double)x : of[MAX_X];
  of[MAX_Y] = (double)y;
}

// Labels are 1 ... n; 0 is no region. `moments` (n, FIGURES) is set, not added to.
EXPORT int region_moments(const uint16_t *labels, const float *depth, double *moments, ptrdiff_t h, ptrdiff_t w,
                          ptrdiff_t n) {
  memset(moments, 0, (size_t)n * FIGURES * sizeof *moments);
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x++) {
      const ptrdiff_t label = labels[y * w + x];
      if (label > n) return WRONG_SIZE;
      if (label > 0) take_in(moments + (label - 1) * FIGURES, x, y, depth[y * w + x]);
    }
  return OK;
}
