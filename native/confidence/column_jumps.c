// How the difference of an image to another jumps from column to column: noise, and the blocks of a compressed frame.
#include "../common.h"

// Sum over every `step`-th row and the channels of |d(x + 1) - d(x)|, for each x.
EXPORT int column_jumps(const uint8_t *image, const uint8_t *rest, int32_t *jumps, int32_t step, ptrdiff_t h, ptrdiff_t w,
                        ptrdiff_t n) {
  if (n != 3 * (w - 1)) return WRONG_SIZE;
  memset(jumps, 0, (size_t)n * sizeof *jumps);
  for (ptrdiff_t y = 0; y < h; y += step) {
    const uint8_t *restrict a = image + 3 * w * y, *restrict b = rest + 3 * w * y;
    for (ptrdiff_t i = 0; i < n; i++) {
      const int32_t jump = (a[i + 3] - b[i + 3]) - (a[i] - b[i]);
      jumps[i] += jump < 0 ? -jump : jump;
    }
  }
  return OK;
}
