// Slopes of a frame under near lights: an inverse light matrix per pixel.
#include "../../common.h"

enum { BLOCK = 64 };

// inverse: planes m00 m01 m02 m10 ... m22. A pixel in shadow, whose n_z vanishes, gets at most the slope 1 / least_share.
EXPORT int near_light_gradients(const float *restrict change, const float *restrict inverse, float *restrict gradients,
                                float least_share, ptrdiff_t h, ptrdiff_t w) {
  const ptrdiff_t n = h * w;
  for (ptrdiff_t start = 0; start < n; start += BLOCK) {
    const ptrdiff_t size = n - start < BLOCK ? n - start : BLOCK;
    const float *restrict m = inverse + start;
    float r[BLOCK], g[BLOCK], b[BLOCK];
    for (ptrdiff_t k = 0; k < size; k++) {
      r[k] = 1 + change[3 * (start + k)];
      g[k] = 1 + change[3 * (start + k) + 1];
      b[k] = 1 + change[3 * (start + k) + 2];
    }
    for (ptrdiff_t k = 0; k < size; k++) {
      const float nx = m[k] * r[k] + m[n + k] * g[k] + m[2 * n + k] * b[k];
      const float ny = m[3 * n + k] * r[k] + m[4 * n + k] * g[k] + m[5 * n + k] * b[k];
      const float nz = m[6 * n + k] * r[k] + m[7 * n + k] * g[k] + m[8 * n + k] * b[k];
      const float down = larger(larger(nz, sqrtf(nx * nx + ny * ny) * least_share), 1e-6f);
      gradients[2 * (start + k)] = -nx / down;
      gradients[2 * (start + k) + 1] = -ny / down;
    }
  }
  return OK;
}
