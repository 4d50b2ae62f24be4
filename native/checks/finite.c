#include "../common.h"

// 1 where every value is finite.
EXPORT int finite_f32(const float *values, ptrdiff_t count) { return times_zero(values, count) == 0.0f; }

// The largest magnitude; NaN is passed over.
EXPORT int magnitude_f32(const float *values, float *largest, ptrdiff_t count) {
  *largest = largest_magnitude(values, count);
  return OK;
}
