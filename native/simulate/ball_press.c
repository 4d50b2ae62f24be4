// The surface of a gel under a ball, from a table of its depth and slope beside the contact.
#include "../common.h"

// Beyond the contact radius cubic Hermite interpolation; beyond the table the gel is at rest, as the outputs are at first.
EXPORT int ball_surface(const double *dx, const double *dy, const double *depth, const double *slope, double *z,
                        double *gradients, bool *touching, double radius, double top, double contact, double step,
                        ptrdiff_t w, ptrdiff_t h, ptrdiff_t points) {
  for (ptrdiff_t i = 0; i < h; i++)
    for (ptrdiff_t j = 0; j < w; j++) {
      const ptrdiff_t at = i * w + j;
      const double square = dx[j] * dx[j] + dy[i] * dy[i], r = sqrt(square);
      double over_r;  // the slope along the radius, over r
      touching[at] = r <= contact;
      if (touching[at]) {
        const double cosine = sqrt(radius * radius - square);
        z[at] = top - radius + cosine, over_r = -1 / cosine;
      } else {
        const double place = (r - contact) / step;
        if (place >= (double)(points - 1)) continue;
        const ptrdiff_t k = (ptrdiff_t)place;
        const double t = place - (double)k, d0 = depth[k], rise = depth[k + 1] - d0;
        const double s0 = step * slope[k], s1 = step * slope[k + 1];
        const double squared = 3 * rise - 2 * s0 - s1, cubed = s0 + s1 - 2 * rise;
        z[at] = d0 + t * (s0 + t * (squared + t * cubed));
        over_r = (s0 + t * (2 * squared + 3 * t * cubed)) / (step * r);
      }
      gradients[2 * at] = over_r * dx[j], gradients[2 * at + 1] = over_r * dy[i];
    }
  return OK;
}
