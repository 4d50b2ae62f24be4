#include "../../common.h"

enum { PIECE = 256 };

// Adds to the deviation of depth what is in proportion to the depth, within `most`. Returns 1 where the sum is not finite.
EXPORT int add_in_proportion(float *sigma, const float *depth, float share, float most, ptrdiff_t count) {
  float zero = 0;
  for (ptrdiff_t start = 0; start < count; start += PIECE) {
    const ptrdiff_t n = count - start < PIECE ? count - start : PIECE;
    float *restrict piece = sigma + start;
    const float *restrict z = depth + start;
    for (ptrdiff_t k = 0; k < n; k++) piece[k] = sqrtf(piece[k] * piece[k] + share * z[k] * (share * z[k]));
    zero += times_zero(piece, n);
    for (ptrdiff_t k = 0; k < n; k++) piece[k] = smaller(piece[k], most);
  }
  return zero == 0 ? OK : 1;
}
