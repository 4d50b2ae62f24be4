// Measures a frame in one pass: its 16x16 blocks, a digest of each row, and the jumps from row to row of its
// difference to the background image.
#include "../common.h"

enum { BLOCK = 16, WIDE = 3 * BLOCK };  // pixels; bytes across a block
enum { STRIP = 4 * WIDE };             // as wide as vectors like it
enum { STEP = 4, SEEN = BLOCK / STEP * BLOCK };  // every fourth row of a block tells a constant from noise
enum { WORDS = 16, PIECE = 64 };  // of a row are digested; bytes compared at a time
enum { MOST = 16 };                // gray levels that a byte adds to a jump: a seam is wide, not high

struct spread {
  uint8_t low[STRIP], high[STRIP];
  uint16_t total[STRIP];
};

static void down(const uint8_t *restrict image, ptrdiff_t pitch, ptrdiff_t bytes, struct spread *restrict of) {
  for (int i = 0; i < STRIP; i++) of->low[i] = 255, of->high[i] = 0, of->total[i] = 0;
  for (int row = 0; row < BLOCK; row += STEP)
    for (ptrdiff_t i = 0; i < bytes; i++) {
      const uint8_t value = image[row * pitch + i];
      of->low[i] = value < of->low[i] ? value : of->low[i];
      of->high[i] = value > of->high[i] ? value : of->high[i];
      of->total[i] += value;
    }
}

// Every byte takes in the one `step` further on; behind steps of 24, 12, 6 and 3 the first pixel of a block holds its all.
static inline void across(const struct spread *restrict from, struct spread *restrict to, const int step) {
  for (int i = 0; i < STRIP - WIDE / 2; i++) to->low[i] = from->low[i] < from->low[i + step] ? from->low[i] : from->low[i + step];
  for (int i = 0; i < STRIP - WIDE / 2; i++) to->high[i] = from->high[i] > from->high[i + step] ? from->high[i] : from->high[i + step];
  for (int i = 0; i < STRIP - WIDE / 2; i++) to->total[i] = from->total[i] + from->total[i + step];
}

static inline uint64_t word_at(const uint8_t *row, ptrdiff_t at, ptrdiff_t bytes) {
  uint64_t word = 0;
  memcpy(&word, row + at, at + 8 <= bytes ? 8 : bytes - at);
  return word;
}

// Digest of up to WORDS words, evenly over the row.
static int64_t digest(const uint8_t *row, ptrdiff_t bytes) {
  const uint64_t prime = 0x9E3779B97F4A7C15u;
  const ptrdiff_t step = bytes / WORDS > 8 ? bytes / WORDS : 8;
  uint64_t even = 1, odd = 2;
  for (ptrdiff_t at = 0; at < bytes; at += 2 * step) even = (even ^ word_at(row, at, bytes)) * prime;
  for (ptrdiff_t at = step; at < bytes; at += 2 * step) odd = (odd ^ word_at(row, at, bytes)) * prime;
  return (int64_t)(even + 3 * odd);
}

static inline void store(const struct spread *of, ptrdiff_t first, uint8_t *mean, uint8_t *range) {
  *range = 0;
  for (int c = 0; c < 3; c++) {
    const uint8_t own = of->high[first + c] - of->low[first + c];
    *range = own > *range ? own : *range;
    mean[c] = (uint8_t)((of->total[first + c] + SEEN / 2) / SEEN);
  }
}

// Mean over a third of the row's bytes, in pieces as wide as vectors like them.
static float jump(const uint8_t *restrict image, const uint8_t *restrict rest, ptrdiff_t pitch, ptrdiff_t bytes) {
  int32_t total = 0;
  ptrdiff_t count = 0;
  for (ptrdiff_t at = 0; at + PIECE <= bytes || at == 0; at += 3 * PIECE) {
    const ptrdiff_t wide = bytes - at < PIECE ? bytes - at : PIECE;
    for (ptrdiff_t i = at; i < at + wide; i++) {
      const int16_t step = (int16_t)((image[i] - image[i - pitch]) - (rest[i] - rest[i - pitch]));
      const int16_t size = step < 0 ? -step : step;
      total += size < MOST ? size : MOST;
    }
    count += wide;
  }
  return (float)total / (float)count;
}

// Mean and range (largest of the channels) of each whole block; of each row a digest, and its jump from the row above.
EXPORT int health_blocks(const uint8_t *image, const uint8_t *rest, uint8_t *means, uint8_t *ranges, int64_t *digests,
                         float *jumps, ptrdiff_t h, ptrdiff_t w, ptrdiff_t bh, ptrdiff_t bw) {
  if (bh != h / BLOCK || bw != w / BLOCK) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y++) {
    digests[y] = digest(image + 3 * w * y, 3 * w);
    jumps[y] = y == 0 ? 0 : jump(image + 3 * w * y, rest + 3 * w * y, 3 * w, 3 * w);
  }
  for (ptrdiff_t k = 0; k < bh; k++)
    for (ptrdiff_t at = 0; at < bw; at += STRIP / WIDE) {
      const ptrdiff_t count = bw - at < STRIP / WIDE ? bw - at : STRIP / WIDE;
      struct spread of, half = {0};
      down(image + 3 * BLOCK * (w * k + at), 3 * w, WIDE * count, &of);
      across(&of, &half, WIDE / 2), across(&half, &of, WIDE / 4);
      across(&of, &half, WIDE / 8), across(&half, &of, WIDE / 16);
      for (ptrdiff_t b = 0; b < count; b++) store(&of, WIDE * b, means + 3 * (bw * k + at + b), ranges + bw * k + at + b);
    }
  return OK;
}
