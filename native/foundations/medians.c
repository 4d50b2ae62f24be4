// Medians over chosen pixels of a map.
#include "../select.h"

// Medians of every channel over the chosen pixels of every `step`-th row and column. Returns the number of pixels; if there are none,
// the medians are 0.
EXPORT int medians_where(const float *values, const bool *chosen, int64_t step, float *work, float *medians, ptrdiff_t h,
                         ptrdiff_t w, ptrdiff_t c, ptrdiff_t n) {
  if (step < 1 || n < 2 * sampled(h, w, step)) return WRONG_SIZE;
  const ptrdiff_t most = sampled(h, w, step);
  ptrdiff_t count = 0;
  for (ptrdiff_t channel = 0; channel < c; channel++) {
    count = 0;
    for (ptrdiff_t y = 0; y < h; y += step)
      for (ptrdiff_t x = 0; x < w; x += step) {
        work[count] = values[(y * w + x) * c + channel];
        count += chosen == NULL || chosen[y * w + x];
      }
    medians[channel] = count ? median(work, count, (uint32_t *)(work + most)) : 0;
  }
  return (int)count;
}
