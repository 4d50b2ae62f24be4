#include "../../common.h"

// Pixels of every `step`-th row and column whose color change is nearer to the common one than the root of `square`, and which
// nothing hides; the others of `near` stay as they are. Returns how many they are.
EXPORT int near_common(const float *change, const bool *hidden, const float *common, bool *near, float square, int64_t step,
                       ptrdiff_t h, ptrdiff_t w) {
  const float r = common[0], g = common[1], b = common[2];
  int32_t count = 0;
  if (step < 1) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y += step)
    for (ptrdiff_t x = 0; x < w; x += step) {
      const ptrdiff_t k = y * w + x;
      const float dr = change[3 * k] - r, dg = change[3 * k + 1] - g, db = change[3 * k + 2] - b;
      near[k] = dr * dr + dg * dg + db * db < square && !(hidden != NULL && hidden[k]);
      count += near[k];
    }
  return count;
}
