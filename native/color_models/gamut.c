// How far the colours of a frame are from those of the training presses, by a table of distances over color change.
#include "../common.h"

// Distance of the nearest bin; beyond the table, that of its border plus the way there times worth.
EXPORT int gamut_distance(const float *restrict change, const float *restrict table, const float *restrict low,
                          float *restrict distance, float per_bin, float worth, ptrdiff_t h, ptrdiff_t w, ptrdiff_t bins) {
  const float last = (float)(bins - 1);
  const float first[3] = {low[0] * per_bin, low[1] * per_bin, low[2] * per_bin};
  for (ptrdiff_t k = 0; k < h * w; k++) {
    int32_t bin = 0;
    float beyond = 0;
    for (int c = 0; c < 3; c++) {
      const float at = change[3 * k + c] * per_bin - first[c];
      const float inside = clamp(at, 0, last);
      beyond += (at - inside) * (at - inside);
      bin = bin * (int32_t)bins + (int32_t)(inside + 0.5f);
    }
    distance[k] = table[bin] + worth * sqrtf(beyond);
  }
  return OK;
}
