#include "../common.h"

// 1 where every value is finite. x * 0 is 0, but NaN for NaN and for infinity, and NaN survives a sum.
EXPORT int finite_f32(const float *values, ptrdiff_t count) {
  float lanes[LANES] = {0};
  ptrdiff_t j = 0;
  for (; j + LANES <= count; j += LANES)
    for (int k = 0; k < LANES; k++) lanes[k] += values[j + k] * 0.0f;
  for (; j < count; j++) lanes[0] += values[j] * 0.0f;
  return lanes_total(lanes) == 0.0f;
}
