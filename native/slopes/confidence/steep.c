// What is not known of steep slopes, which no residual shows: beyond the slopes that presses have shown, and wherever the model
// of another unit may read a steep slope as a usual one.
#include "../../common.h"

static inline float beyond(float x) { return larger(x, 0); }

EXPORT int steep_sigma(const float *gradients, const float *sigma, const float *confidence, float *steep, float *stated,
                       float upper, float per_excess, float doubted, float steepest, float carried, float most, float full_confidence_sigma,
                       ptrdiff_t h, ptrdiff_t w) {
  // One flat loop over pointers that cannot overlap: only so is it compiled to vectors, six times as fast.
  const float *restrict slopes = gradients, *restrict read = sigma, *restrict weight = confidence;
  float *restrict out = steep, *restrict share = stated;
  const float per_fade = 1 / full_confidence_sigma, highest = most * most, full = full_confidence_sigma * full_confidence_sigma;
  for (ptrdiff_t i = 0; i < h * w; i++) {
    const float p = slopes[2 * i], q = slopes[2 * i + 1], slope = sqrtf(p * p + q * q);
    const float own = per_excess * beyond(slope - upper);
    const float other = carried * clamp((slope - doubted) * per_fade + 1, 0, 1) * beyond(steepest - slope);
    const float added = smaller(own * own + other * other, highest);
    const float square = read[i] < most ? added : 0;  // else it was not seen
    out[i] = sqrtf(square);
    share[i] = smaller(weight[i], full / (read[i] * read[i] + square));
  }
  return OK;
}
