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
  float *row, *ring;        // work: (values + 6 radius + LANES), (2 radius + 1, stride)
  ptrdiff_t stride;         // of the ring: values and what fills the last lanes
};

enum { MAX_RADIUS = 512 };

static inline ptrdiff_t whole_lanes(ptrdiff_t n) { return (n + LANES - 1) / LANES * LANES; }

static inline ptrdiff_t blurred_change_work(ptrdiff_t values, ptrdiff_t radius) {
  return values + 6 * radius + LANES + (2 * radius + 1) * whole_lanes(values);
}

// Shares out the work; false where there is too little of it, or the blur reaches too far.
static inline bool place_ring(struct blurred_change *c, float *work, ptrdiff_t size) {
  c->row = work;
  c->ring = work + c->values + 6 * c->radius + LANES;
  c->stride = whole_lanes(c->values);
  return c->radius <= MAX_RADIUS && size >= blurred_change_work(c->values, c->radius);
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

// Rows whose values are weighted by tap k: as far before each value as after it.
struct taken {
  const float *before[MAX_RADIUS + 1], *after[MAX_RADIUS + 1];
};

// What lies behind the n values is read too, up to whole lanes.
static inline void weighted_sum(const struct taken *rows, const float *taps, ptrdiff_t radius, float *out, ptrdiff_t n) {
  for (ptrdiff_t x = 0; x < n; x += LANES) {
    lanes total = taps[0] * load_lanes(rows->before[0] + x);
    for (ptrdiff_t k = 1; k <= radius; k++)
      total += taps[k] * (load_lanes(rows->before[k] + x) + load_lanes(rows->after[k] + x));
    if (n - x >= LANES) store_lanes(out + x, total);
    else memcpy(out + x, &total, (n - x) * sizeof(float));
  }
}

// One more row of the image, its change blurred along x, into the ring.
static inline void fill_ring_row(struct blurred_change *c) {
  const ptrdiff_t y = c->filled++, w = c->values / 3, r = c->radius;
  float *change = c->row + 3 * r;
  struct taken rows;
  change_row(c, y, change);
  for (ptrdiff_t k = 1; k <= r; k++)
    for (ptrdiff_t channel = 0; channel < 3; channel++) {
      change[channel - 3 * k] = change[channel + 3 * mirrored(-k, w)];
      change[channel + 3 * (w - 1 + k)] = change[channel + 3 * mirrored(w - 1 + k, w)];
    }
  for (ptrdiff_t k = 0; k <= r; k++) rows.before[k] = change - 3 * k, rows.after[k] = change + 3 * k;
  weighted_sum(&rows, c->taps, r, c->ring + y % (2 * r + 1) * c->stride, c->values);
}

static inline const float *ring_row(const struct blurred_change *c, ptrdiff_t y) {
  return c->ring + mirrored(y, c->h) % (2 * c->radius + 1) * c->stride;
}

// The change of row y (3 w values); rows are asked for from the first to the last.
static inline void blurred_change_row(struct blurred_change *c, ptrdiff_t y, float *out) {
  const ptrdiff_t r = c->radius;
  struct taken rows;
  if (r == 0) {
    change_row(c, y, out);
    return;
  }
  while (c->filled < c->h && c->filled <= y + r) fill_ring_row(c);
  for (ptrdiff_t k = 0; k <= r; k++) rows.before[k] = ring_row(c, y - k), rows.after[k] = ring_row(c, y + k);
  weighted_sum(&rows, c->taps, r, out, c->values);
}

#endif
