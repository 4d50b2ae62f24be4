// Search for patches of the untouched image in another image: Gauss-Newton steps on their shift, to parts of a pixel.
// Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56, 2004: the inverse compositional algorithm.
#include "../../common.h"

enum { TAPS = 4, MOST_SIDE = 63, MOST_PIXELS = MOST_SIDE * MOST_SIDE };
enum { LIGHT = 6, DOT = 3, BASIS = LIGHT + DOT };  // columns: quadratic light; the dot and its two derivatives

// Catmull-Rom weights of the pixels at -1, 0, 1, 2 for a place t (0-1) beyond pixel 0.
static void weights_at(float t, float w[TAPS]) {
  w[0] = 0.5f * t * (-1 + t * (2 - t));
  w[1] = 0.5f * (2 + t * t * (3 * t - 5));
  w[2] = 0.5f * t * (1 + t * (4 - 3 * t));
  w[3] = 0.5f * t * t * (t - 1);
}

static inline ptrdiff_t within(ptrdiff_t i, ptrdiff_t n) { return i < 0 ? 0 : i >= n ? n - 1 : i; }

// A square of the image whose first pixel lies at (x, y), not on whole pixels; beyond the border its nearest value.
static void sample(const float *image, float x, float y, int side, float *restrict seen, ptrdiff_t h, ptrdiff_t w) {
  static const float far = 1e6f;
  const float column = clamp(x, -far, far), row = clamp(y, -far, far);
  const ptrdiff_t left = (ptrdiff_t)floorf(column) - 1, top = (ptrdiff_t)floorf(row) - 1;
  float across[TAPS], down[TAPS], rows[(MOST_SIDE + TAPS) * MOST_SIDE], line[MOST_SIDE + TAPS];
  weights_at(column - floorf(column), across);
  weights_at(row - floorf(row), down);
  for (int i = 0; i < side + TAPS - 1; i++) {
    const float *from = image + within(top + i, h) * w;
    for (int j = 0; j < side + TAPS - 1; j++) line[j] = from[within(left + j, w)];
    for (int j = 0; j < side; j++)
      rows[i * side + j] = (across[0] * line[j] + across[3] * line[j + 3]) + (across[1] * line[j + 1] + across[2] * line[j + 2]);
  }
  for (int i = 0; i < side; i++)
    for (int j = 0; j < side; j++) {
      const float *at = rows + i * side + j;
      seen[i * side + j] = (down[0] * at[0] + down[3] * at[3 * side]) + (down[1] * at[side] + down[2] * at[2 * side]);
    }
}

// The fit of one sampled patch: coordinates on the orthonormal basis, and what is left of it.
static float projected(const float *restrict seen, const float *restrict weight, const float *basis, int pixels,
                       float *restrict weighted, float on[BASIS]) {
  for (int k = 0; k < pixels; k++) weighted[k] = weight[k] * seen[k];
  float left = dot(weighted, weighted, pixels);
  for (int b = 0; b < BASIS; b++) {
    on[b] = dot(weighted, basis + (ptrdiff_t)b * pixels, pixels);
    left -= on[b] * on[b];
  }
  return larger(left, 0);
}

// `corners`: first pixel of each patch at rest. `basis`: orthonormal, weighted. `triangle`: of its last three columns, so that
// triangle @ (strength, strength * dx, strength * dy) are their coordinates. `shift`: where to start, and where it ended.
// `fit`: strength of the dot against rest, residual energy, energy of the dot's own coordinate, length of the last step.
EXPORT int follow_patches(const float *image, const int32_t *corners, const float *weight, const float *basis,
                          const float *triangle, float *shift, float *fit, int32_t side, int32_t steps, float longest,
                          ptrdiff_t h, ptrdiff_t w, ptrdiff_t n, ptrdiff_t pixels) {
  if (side > MOST_SIDE || (ptrdiff_t)side * side != pixels) return WRONG_SIZE;
  float seen[MOST_PIXELS], weighted[MOST_PIXELS], on[BASIS];
  for (ptrdiff_t i = 0; i < n; i++) {
    const float *of = basis + i * BASIS * pixels, *r = triangle + i * DOT * DOT;
    float *at = shift + 2 * i, *out = fit + 4 * i;
    for (int step = 0; step < steps; step++) {
      sample(image, (float)corners[2 * i] + at[0], (float)corners[2 * i + 1] + at[1], side, seen, h, w);
      out[1] = projected(seen, weight + i * pixels, of, (int)pixels, weighted, on);
      const float dy = on[LIGHT + 2] / r[8], dx = (on[LIGHT + 1] - r[5] * dy) / r[4];
      const float strength = (on[LIGHT] - r[1] * dx - r[2] * dy) / r[0];
      out[0] = strength, out[2] = on[LIGHT] * on[LIGHT];
      const float safe = larger(strength, 0.3f);
      float step_x = dx / safe, step_y = dy / safe;
      const float length = sqrtf(step_x * step_x + step_y * step_y);
      const float shorten = length > longest ? longest / length : 1;
      at[0] -= step_x * shorten, at[1] -= step_y * shorten;
      out[3] = length;
      if (length < 0.004f) break;
    }
  }
  return OK;
}
