// Jumps of the difference of two images from column to column: noise, and the blocks of a compressed frame.
#include "../../select.h"

enum { BLOCK = 8 };  // of JPEG, px

// Mean of |d(x + 1) - d(x)| over every `step`-th row and the channels, for each x; of these the medians over the columns that lie at
// each of 8 places in a block.
EXPORT int column_jumps(const uint8_t *image, const uint8_t *rest, int32_t *work, float *medians, int32_t step, ptrdiff_t h,
                        ptrdiff_t w, ptrdiff_t n) {
  const ptrdiff_t values = 3 * (w - 1), blocks = (w - 1) / BLOCK;
  if (step < 1 || blocks < 1 || n < values + 2 * blocks) return WRONG_SIZE;
  const float count = (float)(3 * ((h + step - 1) / step));
  int32_t *restrict jumps = work;
  float *at_place = (float *)(work + values);
  memset(jumps, 0, (size_t)values * sizeof *jumps);
  for (ptrdiff_t y = 0; y < h; y += step) {
    const uint8_t *restrict a = image + 3 * w * y, *restrict b = rest + 3 * w * y;
    for (ptrdiff_t i = 0; i < values; i++) {
      const int32_t jump = (a[i + 3] - b[i + 3]) - (a[i] - b[i]);
      jumps[i] += jump < 0 ? -jump : jump;
    }
  }
  for (int place = 0; place < BLOCK; place++) {
    for (ptrdiff_t k = 0; k < blocks; k++) {
      const int32_t *of = jumps + 3 * (k * BLOCK + place);
      at_place[k] = (float)(of[0] + of[1] + of[2]) / count;
    }
    medians[place] = median(at_place, blocks, (uint32_t *)(at_place + blocks));
  }
  return OK;
}
