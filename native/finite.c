#include "common.h"

// 1 where every value is finite.
EXPORT int finite_f32(const float *values, ptrdiff_t count) { return times_zero(values, count) == 0.0f; }

enum { PIECE = 4096 };  // values that are read twice while they are in the nearest cache

// The least and the largest of the values; both NaN where a value is not finite.
EXPORT int range_f32(const float *values, float *range, ptrdiff_t count) {
  if (count < 1) return WRONG_SIZE;
  struct range all = {values[0], values[0]};
  float zero = 0;
  for (ptrdiff_t start = 0; start < count; start += PIECE) {
    const ptrdiff_t n = count - start < PIECE ? count - start : PIECE;
    const struct range part = range_of(values + start, n);
    all = (struct range){smaller(part.low, all.low), larger(part.high, all.high)};
    zero += times_zero(values + start, n);
  }
  range[0] = zero == 0 ? all.low : NAN;
  range[1] = zero == 0 ? all.high : NAN;
  return OK;
}
