// The rows of a PNG of 8-bit RGB without interlace, decompressed, without their filters (PNG specification, section 9).
#include "../common.h"

enum { UNKNOWN_FILTER = 1 };  // what png_rows returns
enum { NONE, SUB, UP, AVERAGE, PAETH };
enum { CHANNELS = 3 };

// A pixel's channels side by side: what each is filtered by depends on the pixel before, so that no wider vector helps.
typedef int16_t pixel __attribute__((vector_size(4 * sizeof(int16_t))));

static inline pixel load(const uint8_t *channels) { return (pixel){channels[0], channels[1], channels[2], 0}; }

static inline pixel chosen(pixel where, pixel a, pixel b) { return (where & a) | (~where & b); }

static inline pixel magnitude(pixel x) { return (x ^ (x >> 15)) - (x >> 15); }

// The one of left, above and above left that is nearest to left + above - above left; the first of equals. No branches: on noise they
// would be guessed wrong every other time.
static inline pixel nearest(pixel left, pixel above, pixel corner) {
  const pixel to_left = magnitude(above - corner), to_above = magnitude(left - corner);
  const pixel to_corner = magnitude(above - corner + left - corner), is_left = to_left <= to_above;
  const pixel is_side = chosen(is_left, to_left, to_above) <= to_corner;
  return chosen(is_side, chosen(is_left, left, above), corner);
}

// One row; `above` is the row before, of zeros where it is the first.
static int restored(int filter, const uint8_t *restrict row, const uint8_t *restrict above, uint8_t *restrict out, ptrdiff_t n) {
  switch (filter) {
    case NONE: memcpy(out, row, (size_t)n); return OK;
    case UP:
      for (ptrdiff_t j = 0; j < n; j++) out[j] = (uint8_t)(row[j] + above[j]);
      return OK;
    case SUB: {
      uint8_t left[CHANNELS] = {0};
      for (ptrdiff_t j = 0; j < n; j += CHANNELS)
        for (int c = 0; c < CHANNELS; c++) out[j + c] = left[c] = (uint8_t)(row[j + c] + left[c]);
      return OK;
    }
    case AVERAGE: {
      uint8_t left[CHANNELS] = {0};
      for (ptrdiff_t j = 0; j < n; j += CHANNELS)
        for (int c = 0; c < CHANNELS; c++)
          out[j + c] = left[c] = (uint8_t)(row[j + c] + ((left[c] + above[j + c]) >> 1));
      return OK;
    }
    case PAETH: {
      pixel left = {0}, corner = {0};
      for (ptrdiff_t j = 0; j < n; j += CHANNELS) {
        const pixel next = load(above + j);
        left = (load(row + j) + nearest(left, next, corner)) & 255;
        corner = next;
        for (int c = 0; c < CHANNELS; c++) out[j + c] = (uint8_t)left[c];
      }
      return OK;
    }
    default: return UNKNOWN_FILTER;
  }
}

// Each row of `rows` begins with the number of its filter; `zeros` stands above the first one.
EXPORT int png_rows(const uint8_t *rows, const uint8_t *zeros, uint8_t *pixels, ptrdiff_t h, ptrdiff_t r, ptrdiff_t n) {
  if (r != n + 1 || n % CHANNELS != 0) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < h; i++) {
    const uint8_t *above = i == 0 ? zeros : pixels + (i - 1) * n;
    if (restored(rows[i * r], rows + i * r + 1, above, pixels + i * n, n) != OK) return UNKNOWN_FILTER;
  }
  return OK;
}
