// What is not known of steep slopes, which no residual shows: beyond the slopes that presses have shown, and wherever the model
// of another unit may read a steep slope as a usual one.
#include "../../common.h"

struct shown {
  float upper, per_excess, doubted, steepest, carried, most, full_confidence_sigma;
};

static inline float beyond(float x) { return larger(x, 0); }

EXPORT int steep_sigma(const float *gradients, const float *sigma, const float *confidence, float *steep, float *stated,
                       float upper, float per_excess, float doubted, float steepest, float carried, float most, float full_confidence_sigma,
                       ptrdiff_t h, ptrdiff_t w) {
  const struct shown n = {upper, per_excess, doubted, steepest, carried, most, full_confidence_sigma};
  const float per_fade = 1 / n.full_confidence_sigma;
  for (ptrdiff_t y = 0; y < h; y++) {
    const float *restrict row = gradients + 2 * y * w, *restrict read = sigma + y * w, *restrict weight = confidence + y * w;
    float *restrict out = steep + y * w, *restrict share = stated + y * w;
    for (ptrdiff_t x = 0; x < w; x++) {
      const float slope = sqrtf(row[2 * x] * row[2 * x] + row[2 * x + 1] * row[2 * x + 1]);
      const float own = n.per_excess * beyond(slope - n.upper);
      const float other = n.carried * clamp((slope - n.doubted) * per_fade + 1, 0, 1) * beyond(n.steepest - slope);
      const float square = read[x] < n.most ? smaller(own * own + other * other, n.most * n.most) : 0;  // else it was not seen
      out[x] = sqrtf(square);
      share[x] = smaller(weight[x], n.full_confidence_sigma * n.full_confidence_sigma / (read[x] * read[x] + square));
    }
  }
  return OK;
}
