#include "blurred_change.h"

// Color change of an image against the untouched one: ((image - room) scale - untouched) gain, then a symmetric blur.
EXPORT int color_change(const uint8_t *image, const float *light, const float *scale, const float *untouched,
                        const float *gain, const float *taps, float *work, float *change, ptrdiff_t h, ptrdiff_t w,
                        ptrdiff_t s, ptrdiff_t t, ptrdiff_t n) {
  struct blurred_change rows = {image, light, scale, s, untouched, gain, taps, h, w, t - 1, 0, 0, 0, NULL, NULL, 0};
  if (!is_light(s, h, w) || !place_ring(&rows, work, n)) return WRONG_SIZE;
  const ptrdiff_t width = strip_width(&rows);
  for (ptrdiff_t first = 0; first < w; first += width) {
    begin_strip(&rows, first, width);
    for (ptrdiff_t y = 0; y < h; y++) blurred_change_row(&rows, y, change + 3 * (y * w + first));
  }
  return OK;
}
