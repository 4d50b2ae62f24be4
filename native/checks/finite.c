#include "../common.h"

// 1 where every value is finite.
EXPORT int finite_f32(const float *values, ptrdiff_t count) { return times_zero(values, count) == 0.0f; }
