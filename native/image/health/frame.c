// A frame -> its blocks, and every sign of a fault, in one call.
#include "steps.h"

// `signs`: blocks of one color, channels of blocks at an end of the range, repeated rows, and what thirds of the rows have in common
// (infinite where `gray` or `smooth` is NULL). Returns the row that begins with a step; 0: none does. The rest is as the steps have it.
EXPORT int health_of_frame(const uint8_t *image, const uint8_t *dark_to, const uint8_t *saturated_from, const uint16_t *rest,
                           const float *gray, const float *smooth, uint8_t *means, uint8_t *ranges, int64_t *digests, uint16_t *sums,
                           double *signs, float *work, int32_t flat, float least, float factor, float spill, ptrdiff_t h, ptrdiff_t w,
                           ptrdiff_t bh, ptrdiff_t bw, ptrdiff_t n) {
  int32_t counts[3];
  float common = INFINITY;
  ptrdiff_t places = 1;
  const ptrdiff_t wide = 3 * bw;
  if (n < 3 * h || n < h + 3 * wide || health_blocks(image, means, ranges, digests, sums, h, w, bh, bw) != OK) return WRONG_SIZE;
  while (places <= h) places *= 2;
  health_signs(means, ranges, digests, dark_to, saturated_from, (int32_t *)work, counts, flat, bh, bw, h, places);
  for (int k = 0; k < 3; k++) signs[k] = counts[k];
  if (gray != NULL && smooth != NULL && health_bands(sums, gray, smooth, work, &common, h, bw) != OK) return WRONG_SIZE;
  signs[3] = (double)common;
  return health_seam(sums, rest, work + h, work, least, factor, spill, h, wide, 3 * wide);
}
