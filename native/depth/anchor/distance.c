// Distance of the pixels of a coarse map from those that are chosen.
#include "../../common.h"

// Lengths of a step along a row or column and across a corner, which make a distance nearly Euclidean (G. Borgefors, Distance
// transformations in digital images, Comput. Vis. Graph. Image Process. 34, 1986), in 65536ths: OpenCV's.
enum { ALONG = 62587, ACROSS = 89738, FAR = 1 << 30 };

static inline int32_t nearer(int32_t a, int32_t b) { return a < b ? a : b; }

// Distances by way of the four neighbors that come first; `back` is the number of values in a row, `ahead` the step in it.
static inline int32_t by_way_of(const int32_t *at, ptrdiff_t back, ptrdiff_t ahead) {
  const int32_t beside = at[-ahead] + ALONG, over = at[-back] + ALONG;
  const int32_t corner = nearer(at[-back - ahead], at[-back + ahead]) + ACROSS;
  return nearer(nearer(beside, over), corner);
}

// Distance of each pixel to the nearest chosen one, px, FAR / 65536 where none is.
int distance_to_chosen(const bool *chosen, float *work, float *distance, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  const ptrdiff_t wide = w + 2;
  int32_t *all = (int32_t *)work, *first = all + wide + 1;
  if (n < (h + 2) * wide) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < (h + 2) * wide; k++) all[k] = FAR;
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x++) {
      int32_t *at = first + y * wide + x;
      *at = chosen[y * w + x] ? 0 : nearer(by_way_of(at, wide, 1), FAR);
    }
  for (ptrdiff_t y = h - 1; y >= 0; y--)
    for (ptrdiff_t x = w - 1; x >= 0; x--) {
      int32_t *at = first + y * wide + x;
      *at = nearer(*at, by_way_of(at, -wide, -1));
      distance[y * w + x] = (float)*at * (1.0f / 65536);
    }
  return OK;
}
