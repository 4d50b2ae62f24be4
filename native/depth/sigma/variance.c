// Depths of probes -> the variance of blocks, smooth.
#include "../../image/background/blurred_change.h"

static float mean_square(const float *depths, ptrdiff_t n) { return dot(depths, depths, n) / (float)n; }

// Blurred down the columns with symmetric taps, mirrored at the border.
static void blur_down(const float *plane, const float *taps, ptrdiff_t radius, ptrdiff_t i, float *restrict out, ptrdiff_t h, ptrdiff_t w) {
  const float *restrict middle = plane + i * w;
  for (ptrdiff_t j = 0; j < w; j++) out[j] = taps[0] * middle[j];
  for (ptrdiff_t k = 1; k <= radius; k++) {
    const float *restrict up = plane + mirrored(i - k, h) * w, *restrict low = plane + mirrored(i + k, h) * w;
    for (ptrdiff_t j = 0; j < w; j++) out[j] += taps[k] * (up[j] + low[j]);
  }
}

// Along a row that has `radius` values before and after it.
static void blur_along(float *row, const float *taps, ptrdiff_t radius, float *restrict out, ptrdiff_t w) {
  for (ptrdiff_t k = 1; k <= radius; k++) row[-k] = row[mirrored(-k, w)], row[w - 1 + k] = row[mirrored(w - 1 + k, w)];
  for (ptrdiff_t j = 0; j < w; j++) out[j] = taps[0] * row[j];
  for (ptrdiff_t k = 1; k <= radius; k++)
    for (ptrdiff_t j = 0; j < w; j++) out[j] += taps[k] * (row[j - k] + row[j + k]);
}

// Mean square over the n probes of each block, averaged over neighbors inside the mask with the taps of a blur.
EXPORT int variance_of_depths(const float *depths, const bool *mask, const float *taps, float *work, float *variance, ptrdiff_t h,
                              ptrdiff_t w, ptrdiff_t n, ptrdiff_t t, ptrdiff_t m) {
  const ptrdiff_t radius = t - 1;
  float *squares = work, *inside = work + h * w, *row = inside + h * w + radius, *share = row + w + radius;
  if (m < 2 * h * w + 2 * w + 2 * radius) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < h * w; k++) {
    inside[k] = mask[k];
    squares[k] = mask[k] ? mean_square(depths + k * n, n) : 0;
  }
  for (ptrdiff_t i = 0; i < h; i++) {
    float *restrict out = variance + i * w;
    blur_down(inside, taps, radius, i, row, h, w);
    blur_along(row, taps, radius, share, w);
    blur_down(squares, taps, radius, i, row, h, w);
    blur_along(row, taps, radius, out, w);
    for (ptrdiff_t j = 0; j < w; j++) out[j] /= larger(share[j], 1e-6f);
  }
  return OK;
}
