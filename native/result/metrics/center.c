// The place of a ball of known radius whose slopes agree best with the given ones.
#include "../../common.h"

// Weighted sums of a Gauss-Newton step: J^T J, of which two entries are alike, and J^T r.
struct normal {
  double xx, xy, yy, x, y;
};

// Terms of a pixel with the slope (p, q): the ball's slope there, its derivative by the center, a pseudo-Huber weight.
static inline struct normal at_pixel(double p, double q, double u, double v, double per_radius, double per_scale,
                                     double least) {
  const double square = 1 - u * u - v * v;
  const double height = sqrt(square > least ? square : least), a = -u / height, b = -v / height;
  const double off_p = p - a, off_q = q - b, length = sqrt(1 + a * a + b * b) * per_radius;
  const double xx = (1 + a * a) * length, xy = a * b * length, yy = (1 + b * b) * length;
  const double weight = 1 / sqrt(1 + (off_p * off_p + off_q * off_q) * per_scale);
  return (struct normal){weight * (xx * xx + xy * xy), weight * (xx + yy) * xy, weight * (xy * xy + yy * yy),
                         weight * (xx * off_p + xy * off_q), weight * (xy * off_p + yy * off_q)};
}

static inline double within(double x, double limit) { return x > limit ? limit : x < -limit ? -limit : x; }

// Gauss-Newton from `center`, which becomes the place found: at most `rounds` steps, each of at most a fifth of the radius, until one
// is shorter than a thousandth of a pixel. Beyond `held` of the radius the slopes of the ball are held.
EXPORT int ball_center(const double *gradients, const double *x, const double *y, double *center, double radius, double scale,
                       double held, int64_t rounds, ptrdiff_t n) {
  const double per_radius = 1 / radius, per_scale = 1 / (scale * scale), least = 1 - held * held, most = 0.2 * radius, tiny = 1e-12;
  for (int64_t round = 0; round < rounds; round++) {
    struct normal sum = {tiny, 0, tiny, 0, 0};
    for (ptrdiff_t k = 0; k < n; k++) {
      const double u = (x[k] - center[0]) * per_radius, v = (y[k] - center[1]) * per_radius;
      const struct normal one = at_pixel(gradients[2 * k], gradients[2 * k + 1], u, v, per_radius, per_scale, least);
      sum.xx += one.xx, sum.xy += one.xy, sum.yy += one.yy, sum.x += one.x, sum.y += one.y;
    }
    const double determinant = sum.xx * sum.yy - sum.xy * sum.xy;
    const double right = (sum.yy * sum.x - sum.xy * sum.y) / determinant, down = (sum.xx * sum.y - sum.xy * sum.x) / determinant;
    center[0] += within(right, most), center[1] += within(down, most);
    if (sqrt(right * right + down * down) < 1e-3) break;
  }
  return OK;
}
