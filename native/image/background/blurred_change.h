// image -> color change, blurred, one row after the other: what follows can read each row while it is in the cache.
#ifndef GELFORM_BLURRED_CHANGE_H
#define GELFORM_BLURRED_CHANGE_H
#include "../../common.h"

// An image, what it is compared with, and a ring of rows that are blurred along x but not yet along y. The frame is worked on in
// strips of some columns, so that the ring stays in the nearest cache.
struct blurred_change {
  const uint8_t *bytes;     // the image (h, 3 w), or NULL where it is
  const float *light;       // (h, 3 w)
  const float *scale;       // (3 w), by which the image is multiplied: the light of each column; in a tilted or a room's light also
                            // (3 h), of each row, and (3), gray levels that are subtracted before
  ptrdiff_t scale_size;
  const float *untouched;   // (h, 3 w)
  const float *gain;        // (h, 3 w)
  const float *taps;        // (radius + 1) of a symmetric blur, the middle first
  ptrdiff_t h, w, radius;   // px
  ptrdiff_t first, count;   // columns of the strip, px
  ptrdiff_t filled;         // rows that are in the ring or have been
  float *row, *ring;        // work: of the strip, with what the blur reaches on both sides; (2 radius + 1, stride)
  ptrdiff_t stride;         // of the ring: values of the strip's rows and what fills the last lanes
};

enum { MAX_RADIUS = 512 };
enum { STRIP_FLOATS = 6144, STRIP_ALIGNED = 16 };  // of the ring, as fit into the nearest cache beside other rows; pixels

static inline ptrdiff_t whole_lanes(ptrdiff_t n) { return (n + LANES - 1) / LANES * LANES; }

static inline ptrdiff_t blurred_change_work(ptrdiff_t w, ptrdiff_t radius) {
  return 3 * w + 6 * radius + LANES + (2 * radius + 1) * whole_lanes(3 * w);
}

// Shares out the work; false where there is too little of it, or the blur reaches too far.
static inline bool place_ring(struct blurred_change *c, float *work, ptrdiff_t size) {
  c->row = work;
  c->ring = work + 3 * c->w + 6 * c->radius + LANES;
  return c->radius <= MAX_RADIUS && size >= blurred_change_work(c->w, c->radius);
}

// Number of columns of a strip; all strips are about equally wide.
static inline ptrdiff_t strip_width(const struct blurred_change *c) {
  const ptrdiff_t most = STRIP_FLOATS / (3 * (2 * c->radius + 1)), widest = most < 64 ? 64 : most;
  const ptrdiff_t strips = c->radius == 0 ? 1 : (c->w + widest - 1) / widest, width = (c->w + strips - 1) / strips;
  return (width + STRIP_ALIGNED - 1) / STRIP_ALIGNED * STRIP_ALIGNED;
}

static inline void begin_strip(struct blurred_change *c, ptrdiff_t first, ptrdiff_t width) {
  c->first = first;
  c->count = c->w - first < width ? c->w - first : width;
  c->stride = whole_lanes(3 * c->count);
  c->filled = 0;
}

// Index of a pixel beyond a border of n pixels, mirrored at the outermost pixel's middle.
static inline ptrdiff_t mirrored(ptrdiff_t i, ptrdiff_t n) {
  if (n == 1) return 0;
  while (i < 0 || i >= n) i = i < 0 ? -i : 2 * n - 2 - i;
  return i;
}

enum { PATTERN = 3 * LANES };  // values after which channels and lanes begin again

// Whether a light of so many values is a gain of each channel, or tilted and a room's too.
static inline bool is_light(ptrdiff_t size, ptrdiff_t h, ptrdiff_t w) { return size == 3 * w || size == 3 * (w + h + 1); }

// Color change of n values, at most as many as the pattern's, in another light.
static inline void lit_change(const float *restrict image, const float *restrict room, const float *restrict scale,
                              const float *restrict of_row, const float *restrict untouched, const float *restrict gain,
                              float *restrict change, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) change[k] = ((image[k] - room[k]) * (scale[k] * of_row[k]) - untouched[k]) * gain[k];
}

// Color change, before the blur, of the pixels from ... to - 1 of row y.
static inline void change_row(const struct blurred_change *c, ptrdiff_t y, ptrdiff_t from, ptrdiff_t to, float *restrict change) {
  const ptrdiff_t at = 3 * (y * c->w + from), n = 3 * (to - from);
  const float *restrict scale = c->scale + 3 * from, *restrict untouched = c->untouched + at, *restrict gain = c->gain + at;
  const uint8_t *restrict bytes = c->bytes != NULL ? c->bytes + at : NULL;
  const float *restrict light = c->bytes != NULL ? NULL : c->light + at;
  if (c->scale_size > 3 * c->w) {
    const float *rows = c->scale + 3 * (c->w + y), *rooms = c->scale + 3 * (c->w + c->h);
    float image[PATTERN], of_row[PATTERN], room[PATTERN];
    for (int k = 0; k < PATTERN; k++) of_row[k] = rows[k % 3], room[k] = rooms[k % 3];
    for (ptrdiff_t x = 0; x < n; x += PATTERN) {
      const ptrdiff_t most = n - x < PATTERN ? n - x : PATTERN;
      for (ptrdiff_t k = 0; k < most; k++) image[k] = bytes != NULL ? (float)bytes[x + k] : light[x + k];
      lit_change(image, room, scale + x, of_row, untouched + x, gain + x, change + x, most);
    }
  } else if (bytes != NULL) {
    for (ptrdiff_t x = 0; x < n; x++) change[x] = ((float)bytes[x] * scale[x] - untouched[x]) * gain[x];
  } else {
    for (ptrdiff_t x = 0; x < n; x++) change[x] = (light[x] * scale[x] - untouched[x]) * gain[x];
  }
}

// Rows whose values are weighted by tap k: as far before each value as after it.
struct taken {
  const float *before[MAX_RADIUS + 1], *after[MAX_RADIUS + 1];
};

// Reads beyond the n values too, up to whole lanes. Two lanes at a time: taps and rows are looked up half as often.
static inline void weighted_sum(const struct taken *rows, const float *taps, ptrdiff_t radius, float *out, ptrdiff_t n) {
  ptrdiff_t x = 0;
  for (; x + 2 * LANES <= n; x += 2 * LANES) {
    lanes one = taps[0] * load_lanes(rows->before[0] + x), other = taps[0] * load_lanes(rows->before[0] + x + LANES);
    for (ptrdiff_t k = 1; k <= radius; k++) {
      const float *before = rows->before[k] + x, *after = rows->after[k] + x, tap = taps[k];
      one += tap * (load_lanes(before) + load_lanes(after));
      other += tap * (load_lanes(before + LANES) + load_lanes(after + LANES));
    }
    store_lanes(out + x, one);
    store_lanes(out + x + LANES, other);
  }
  for (; x < n; x += LANES) {
    lanes total = taps[0] * load_lanes(rows->before[0] + x);
    for (ptrdiff_t k = 1; k <= radius; k++)
      total += taps[k] * (load_lanes(rows->before[k] + x) + load_lanes(rows->after[k] + x));
    if (n - x >= LANES) store_lanes(out + x, total);
    else memcpy(out + x, &total, (n - x) * sizeof(float));
  }
}

// Pixels from ... to - 1, which are beyond the border; `row` begins with pixel `before`.
static inline void mirror_pixels(float *row, ptrdiff_t before, ptrdiff_t from, ptrdiff_t to, ptrdiff_t w) {
  for (ptrdiff_t x = from; x < to; x++)
    for (int c = 0; c < 3; c++) row[3 * (x - before) + c] = row[3 * (mirrored(x, w) - before) + c];
}

// One more row of the image, its change blurred along x, into the ring.
static inline void fill_ring_row(struct blurred_change *c) {
  const ptrdiff_t y = c->filled++, r = c->radius, before = c->first - r, after = c->first + c->count + r;
  const ptrdiff_t from = before < 0 ? 0 : before, to = after > c->w ? c->w : after;
  float *change = c->row;  // of pixel `before`
  struct taken rows;
  change_row(c, y, from, to, change + 3 * (from - before));
  mirror_pixels(change, before, before, from, c->w);
  mirror_pixels(change, before, to, after, c->w);
  for (ptrdiff_t k = 0; k <= r; k++) rows.before[k] = change + 3 * (r - k), rows.after[k] = change + 3 * (r + k);
  weighted_sum(&rows, c->taps, r, c->ring + y % (2 * r + 1) * c->stride, 3 * c->count);
}

static inline const float *ring_row(const struct blurred_change *c, ptrdiff_t y) {
  return c->ring + mirrored(y, c->h) % (2 * c->radius + 1) * c->stride;
}

// The change of the strip's pixels in row y; rows are asked for from the first to the last.
static inline void blurred_change_row(struct blurred_change *c, ptrdiff_t y, float *out) {
  const ptrdiff_t r = c->radius;
  struct taken rows;
  if (r == 0) {
    change_row(c, y, c->first, c->first + c->count, out);
    return;
  }
  while (c->filled < c->h && c->filled <= y + r) fill_ring_row(c);
  for (ptrdiff_t k = 0; k <= r; k++) rows.before[k] = ring_row(c, y - k), rows.after[k] = ring_row(c, y + k);
  weighted_sum(&rows, c->taps, r, out, 3 * c->count);
}

#endif
