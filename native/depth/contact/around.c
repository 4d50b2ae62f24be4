// The color change around a contact and inside it, on a coarse grid of the image.
#include "../../bilinear.h"
#include "../../select.h"

enum { CHANNELS = 3 };

// A channel of the image between four pixels; 8-bit levels are rounded.
static inline float level_at(const uint8_t *pixels, const float *levels, ptrdiff_t upper, ptrdiff_t lower, ptrdiff_t left,
                             ptrdiff_t right, float down, float along) {
  float corner[4];
  const ptrdiff_t at[] = {upper + left, upper + right, lower + left, lower + right};
  for (int k = 0; k < 4; k++) corner[k] = pixels != NULL ? (float)pixels[at[k]] : levels[at[k]];
  const float above = corner[0] + along * (corner[1] - corner[0]), below = corner[2] + along * (corner[3] - corner[2]);
  const float level = above + down * (below - above);
  return pixels != NULL ? floorf(level + 0.5f) : level;
}

// Whether a pixel of a mask is set, or one beside it.
static inline bool near_set(const float *mask, ptrdiff_t i, ptrdiff_t j, ptrdiff_t r, ptrdiff_t c) {
  for (ptrdiff_t y = i - (i > 0); y <= i + (i < r - 1); y++)
    for (ptrdiff_t x = j - (j > 0); x <= j + (j < c - 1); x++)
      if (mask[y * c + x] > 0) return true;
  return false;
}

// RMS of a channel of `gain` times the coarse levels less `rest`: its median outside the contact, but for a coarse pixel around it, and its
// mean inside. `pixels` or `levels`: the image. Returns 1 if there is an outside, and 2 more if there is an inside; what is not there is 0.
EXPORT int color_around(const uint8_t *pixels, const float *levels, const bool *contact, const float *gain, const float *rest,
                        float *coarse, float *work, float *changes, ptrdiff_t h, ptrdiff_t w, ptrdiff_t r, ptrdiff_t c, ptrdiff_t n) {
  float *fraction = work + c, *inside = fraction + c, *around = inside + r * c, total = 0, down;
  int32_t *first = (int32_t *)work;
  ptrdiff_t within = 0, outside = 0;
  if (n < 2 * c + 3 * r * c || r < 1 || c < 1) return WRONG_SIZE;
  places_in_row(c, (double)w / (double)c, w, first, fraction);
  for (ptrdiff_t i = 0; i < r; i++)
    for (ptrdiff_t j = 0; j < c; j++) inside[i * c + j] = contact[i * h / r * w + j * w / c] ? 1 : 0;
  for (ptrdiff_t i = 0; i < r; i++) {
    const ptrdiff_t upper = between(i, (double)h / (double)r, h, &down) * w * CHANNELS, lower = upper + (h > 1 ? w * CHANNELS : 0);
    for (ptrdiff_t j = 0; j < c; j++) {
      const ptrdiff_t at = i * c + j, left = first[j] * CHANNELS, right = left + (w > 1 ? CHANNELS : 0);
      float square = 0;
      for (ptrdiff_t k = CHANNELS * at; k < CHANNELS * (at + 1); k++) {
        const ptrdiff_t channel = k - CHANNELS * at;
        coarse[k] = level_at(pixels, levels, upper + channel, lower + channel, left, right, down, fraction[j]);
        square += square_of(coarse[k] * gain[k] - rest[k]);
      }
      const float change = sqrtf(square / CHANNELS);
      if (inside[at] > 0) total += change, within++;
      else if (!near_set(inside, i, j, r, c)) around[outside++] = change;
    }
  }
  changes[0] = outside > 0 ? kth_smallest(around, outside, outside / 2, (uint32_t *)(around + r * c)) : 0;
  changes[1] = within > 0 ? total / (float)within : 0;
  return (outside > 0) + 2 * (within > 0);
}
