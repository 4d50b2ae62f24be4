// A first check of a frame's blocks and rows: whether any fault is possible at all.
#include "steps.h"

// Number of n > 0 digests that equal an earlier one. `places`: scratch, a power of two of more than n of them.
static int32_t repeated(const int64_t *restrict digests, int32_t *restrict places, ptrdiff_t n, ptrdiff_t size) {
  int32_t count = 0;
  for (ptrdiff_t k = 0; k < size; k++) places[k] = -1;
  for (ptrdiff_t i = 0; i < n; i++) {
    const uint64_t mixed = (uint64_t)digests[i] * 0x9E3779B97F4A7C15u;
    ptrdiff_t at = (ptrdiff_t)(mixed >> 32) & (size - 1);
    while (places[at] >= 0 && digests[places[at]] != digests[i]) at = (at + 1) & (size - 1);
    count += places[at] >= 0;
    if (places[at] < 0) places[at] = (int32_t)i;
  }
  return count;
}

// Signs: how many blocks hold one color; how many of their channels lie at an end of the range; how many rows repeat another.
EXPORT int health_signs(const uint8_t *means, const uint8_t *ranges, const int64_t *digests, const uint8_t *dark_to,
                        const uint8_t *saturated_from, int32_t *work, int32_t *signs, int32_t flat, ptrdiff_t bh, ptrdiff_t bw, ptrdiff_t h,
                        ptrdiff_t n) {
  if (n <= h || (n & (n - 1)) != 0) return WRONG_SIZE;
  for (int k = 0; k < 3; k++) signs[k] = 0;
  for (ptrdiff_t k = 0; k < bh * bw; k++) signs[0] += ranges[k] <= flat;
  for (ptrdiff_t k = 0; k < 3 * bh * bw; k++) signs[1] += (means[k] < dark_to[k]) | (means[k] >= saturated_from[k]);
  signs[2] = repeated(digests, work, h, n);
  return OK;
}
