// The image of linear levels: noise, response curve, rounding to 0-255.
#include "../common.h"

enum { BLOCK = 256 };
static const float TO_WHOLE = 12582912;  // 1.5 * 2^23: adding and subtracting it rounds to even, as rint does

static void add_noise(float *restrict level, const uint16_t *restrict drawn, const float *restrict normal, float variance,
                      float gain, ptrdiff_t n) {
  float scale[BLOCK];
  for (ptrdiff_t j = 0; j < n; j++) scale[j] = sqrtf(variance + gain * larger(level[j], 0));
  for (ptrdiff_t j = 0; j < n; j++) level[j] += scale[j] * normal[drawn[j]];
}

// `curve` is even in the square root of the level, 0 to 1; levels beyond 1 go on along its last piece.
static void respond(float *restrict level, const float *restrict curve, ptrdiff_t points, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) level[j] = (float)(points - 1) * sqrtf(larger(level[j], 0) * (1 / 255.0f));
  for (ptrdiff_t j = 0; j < n; j++) {
    const int32_t whole = (int32_t)smaller(level[j], (float)(points - 2));
    level[j] = curve[whole] + (level[j] - (float)whole) * (curve[whole + 1] - curve[whole]);
  }
}

// Variance of the noise: `variance + gain * level`. Without `drawn` there is none, without `curve` the response is linear.
EXPORT int gray_levels(const float *levels, const uint16_t *drawn, const float *normal, const float *curve, uint8_t *gray,
                       float variance, float gain, ptrdiff_t count, ptrdiff_t points) {
  for (ptrdiff_t start = 0; start < count; start += BLOCK) {
    const ptrdiff_t n = count - start < BLOCK ? count - start : BLOCK;
    float level[BLOCK];
    memcpy(level, levels + start, (size_t)n * sizeof *level);
    if (drawn) add_noise(level, drawn + start, normal, variance, gain, n);
    if (curve) respond(level, curve, points, n);
    for (ptrdiff_t j = 0; j < n; j++) gray[start + j] = (uint8_t)(int32_t)(clamp(level[j], 0, 255) + TO_WHOLE - TO_WHOLE);
  }
  return OK;
}
