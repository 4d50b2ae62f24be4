// image -> color change, blurred, one row after the other: what follows can read each row while it is in the cache.
#ifndef GELFORM_BLURRED_CHANGE_H
#define GELFORM_BLURRED_CHANGE_H
#include "../common.h"

// An image, what it is compared with, and a ring of rows that are blurred along x but not yet along y.
struct blurred_change {
  const uint8_t *bytes;     // the image (h, 3 w), or NULL where it is
  const float *light;       // (h, 3 w)
  const float *scale;       // (3 w), by which the image is multiplied: the exposure
  const float *untouched;   // (h, 3 w)
  const float *gain;        // (h, 3 w)
  const float *taps;        // (radius + 1) of a symmetric blur, the middle first
  ptrdiff_t h, values, radius, filled;  // values: 3 w; filled: rows that are in the ring or have been
  float *row, *ring;        // work: (values + 6 radius), (2 radius + 1, values)
};

static inline ptrdiff_t blurred_change_work(ptrdiff_t values, ptrdiff_t radius) {
  return values + 6 * radius + (2 * radius + 1) * values;
}

// Index of a pixel beyond a border of n pixels, mirrored at the outermost pixel's middle.
static inline ptrdiff_t mirrored(ptrdiff_t i, ptrdiff_t n) {
  if (n == 1) return 0;
  while (i < 0 || i >= n) i = i < 0 ? -i : 2 * n - 2 - i;
  return i;
}

static inline void change_row(const struct blurred_change *c, ptrdiff_t y, float *restrict change) {
  const float *restrict scale = c->scale, *restrict untouched = c->untouched + y * c->values,
              *restrict gain = c->gain + y * c->values;
  if (c->bytes != NULL) {
    const uint8_t *restrict image = c->bytes + y * c->values;
    for (ptrdiff_t x = 0; x < c->values; x++) change[x] = ((float)image[x] * scale[x] - untouched[x]) * gain[x];
  } else {
    const float *restrict image = c->light + y * c->values;
    for (ptrdiff_t x = 0; x < c->values; x++) change[x] = (image[x] * scale[x] - untouched[x]) * gain[x];
  }
}

static inline void add_taps(const float *restrict before, const float *restrict after, float tap, float *restrict out,
                            ptrdiff_t n) {
  for (ptrdiff_t x = 0; x < n; x++) out[x] += tap * (before[x] + after[x]);
}

static inline void middle_tap(const float *restrict values, float tap, float *restrict out, ptrdiff_t n) {
  for (ptrdiff_t x = 0; x < n; x++) out[x] = tap * values[x];
}

enum { STRIP = 256 };  // values at a time: they stay in the nearest cache while all taps are added

// One more row of the image, its change blurred along x, into the ring.
static inline void fill_ring_row(struct blurred_change *c) {
  const ptrdiff_t y = c->filled++, w = c->values / 3, r = c->radius;
  float *change = c->row + 3 * r, *into = c->ring + y % (2 * r + 1) * c->values;
  change_row(c, y, change);
  for (ptrdiff_t k = 1; k <= r; k++)
    for (ptrdiff_t channel = 0; channel < 3; channel++) {
      change[channel - 3 * k] = change[channel + 3 * mirrored(-k, w)];
      change[channel + 3 * (w - 1 + k)] = change[channel + 3 * mirrored(w - 1 + k, w)];
    }
  for (ptrdiff_t start = 0; start < c->values; start += STRIP) {
    const ptrdiff_t n = c->values - start < STRIP ? c->values - start : STRIP;
    middle_tap(change + start, c->taps[0], into + start, n);
    for (ptrdiff_t k = 1; k <= r; k++)
      add_taps(change + start - 3 * k, change + start + 3 * k, c->taps[k], into + start, n);
  }
}

static inline const float *ring_row(const struct blurred_change *c, ptrdiff_t y) {
  return c->ring + mirrored(y, c->h) % (2 * c->radius + 1) * c->values;
}

// The change of row y (3 w values); rows are asked for from the first to the last.
static inline void blurred_change_row(struct blurred_change *c, ptrdiff_t y, float *out) {
  const ptrdiff_t r = c->radius;
  if (r == 0) {
    change_row(c, y, out);
    return;
  }
  while (c->filled < c->h && c->filled <= y + r) fill_ring_row(c);
  for (ptrdiff_t start = 0; start < c->values; start += STRIP) {
    const ptrdiff_t n = c->values - start < STRIP ? c->values - start : STRIP;
    middle_tap(ring_row(c, y) + start, c->taps[0], out + start, n);
    for (ptrdiff_t k = 1; k <= r; k++)
      add_taps(ring_row(c, y - k) + start, ring_row(c, y + k) + start, c->taps[k], out + start, n);
  }
}

#endif
