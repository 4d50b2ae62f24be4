// The height of triangles seen from above.
#include "../common.h"

static inline double least(const double *a, const double *b, const double *c) {
  const double m = *a < *b ? *a : *b;
  return m < *c ? m : *c;
}

static inline double most(const double *a, const double *b, const double *c) {
  const double m = *a > *b ? *a : *b;
  return m > *c ? m : *c;
}

// The first and last of `size` samples at `start + k step` within an interval.
static inline void samples_in(double low, double high, double start, double step, ptrdiff_t size, ptrdiff_t *first, ptrdiff_t *last) {
  const double from = ceil((low - start) / step), to = floor((high - start) / step);
  *first = from > 0 ? (ptrdiff_t)(from < (double)size ? from : (double)size) : 0;
  *last = to < (double)size ? (ptrdiff_t)(to > -1 ? to : -1) : size - 1;
}

// Raises `height`, -inf at first, to every triangle that is over it.
EXPORT int rasterise(const double *vertices, const int64_t *triangles, double *height, double x0, double y0, double hx,
                     double hy, ptrdiff_t count, ptrdiff_t faces, ptrdiff_t h, ptrdiff_t w) {
  for (ptrdiff_t k = 0; k < faces; k++) {
    const int64_t *corner = triangles + 3 * k;
    for (int n = 0; n < 3; n++)
      if (corner[n] < 0 || corner[n] >= count) return WRONG_SIZE;
    const double *a = vertices + 3 * corner[0], *b = vertices + 3 * corner[1], *c = vertices + 3 * corner[2];
    const double area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    if (area == 0) continue;
    ptrdiff_t i0, i1, j0, j1;
    samples_in(least(a, b, c), most(a, b, c), x0, hx, w, &j0, &j1);
    samples_in(least(a + 1, b + 1, c + 1), most(a + 1, b + 1, c + 1), y0, hy, h, &i0, &i1);
    for (ptrdiff_t i = i0; i <= i1; i++)
      for (ptrdiff_t j = j0; j <= j1; j++) {
        const double x = x0 + (double)j * hx - a[0], y = y0 + (double)i * hy - a[1];
        const double u = (x * (c[1] - a[1]) - (c[0] - a[0]) * y) / area, v = ((b[0] - a[0]) * y - x * (b[1] - a[1])) / area;
        const double z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]);
        if (u >= -1e-12 && v >= -1e-12 && u + v <= 1 + 1e-12 && z > height[i * w + j]) height[i * w + j] = z;
      }
  }
  return OK;
}
