// Measures a frame in one pass: its 16x16 blocks, a digest of each row, and the sums of each row's pieces of 16 pixels.
#include "steps.h"

enum { BLOCK = 16, WIDE = 3 * BLOCK };  // pixels; bytes across a block
enum { STRIP = 4 * WIDE };             // as wide as vectors like it
enum { STEP = 4, SEEN = BLOCK / STEP * BLOCK };  // every fourth row of a block tells a constant from noise
enum { WORDS = 16 };  // of a row are digested

struct spread {
  uint8_t low[STRIP], high[STRIP];
};

static void down(const uint8_t *restrict image, ptrdiff_t pitch, ptrdiff_t bytes, struct spread *restrict of) {
  for (int i = 0; i < STRIP; i++) of->low[i] = 255, of->high[i] = 0;
  for (int row = 0; row < BLOCK; row += STEP)
    for (ptrdiff_t i = 0; i < bytes; i++) {
      const uint8_t value = image[row * pitch + i];
      of->low[i] = value < of->low[i] ? value : of->low[i];
      of->high[i] = value > of->high[i] ? value : of->high[i];
    }
}

// Every byte takes in the one `step` further on; behind steps of 24, 12, 6 and 3 the first pixel of a block holds its all.
static inline void across(const struct spread *restrict from, struct spread *restrict to, const int step) {
  for (int i = 0; i < STRIP - WIDE / 2; i++) to->low[i] = from->low[i] < from->low[i + step] ? from->low[i] : from->low[i + step];
  for (int i = 0; i < STRIP - WIDE / 2; i++) to->high[i] = from->high[i] > from->high[i + step] ? from->high[i] : from->high[i + step];
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

// Sums (blocks, 3) of a row's pieces as wide as a block.
static void add_up(const uint8_t *restrict row, ptrdiff_t blocks, uint16_t *restrict sums) {
  for (ptrdiff_t at = 0; at < blocks; at += STRIP / WIDE) {
    const ptrdiff_t count = blocks - at < STRIP / WIDE ? blocks - at : STRIP / WIDE;
    uint16_t one[STRIP] = {0}, other[STRIP] = {0};
    for (ptrdiff_t i = 0; i < WIDE * count; i++) one[i] = row[WIDE * at + i];
    for (int i = 0; i < STRIP - WIDE / 2; i++) other[i] = one[i] + one[i + WIDE / 2];
    for (int i = 0; i < STRIP - WIDE / 2; i++) one[i] = other[i] + other[i + WIDE / 4];
    for (int i = 0; i < STRIP - WIDE / 2; i++) other[i] = one[i] + one[i + WIDE / 8];
    for (ptrdiff_t b = 0; b < count; b++)
      for (int c = 0; c < 3; c++) sums[3 * (at + b) + c] = other[WIDE * b + c] + other[WIDE * b + c + 3];
  }
}

static inline void store(const struct spread *of, const uint16_t *sums, ptrdiff_t pitch, ptrdiff_t first, uint8_t *mean, uint8_t *range) {
  *range = 0;
  for (int c = 0; c < 3; c++) {
    const uint8_t own = of->high[first + c] - of->low[first + c];
    *range = own > *range ? own : *range;
    int total = SEEN / 2;
    for (int row = 0; row < BLOCK; row += STEP) total += sums[row * pitch + c];
    mean[c] = (uint8_t)(total / SEEN);
  }
}

// Mean and range (largest of the channels) of each whole block; of each row a digest, and its sums.
EXPORT int health_blocks(const uint8_t *image, uint8_t *means, uint8_t *ranges, int64_t *digests, uint16_t *sums, ptrdiff_t h,
                         ptrdiff_t w, ptrdiff_t bh, ptrdiff_t bw) {
  if (bh != h / BLOCK || bw != w / BLOCK) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y++) {
    digests[y] = digest(image + 3 * w * y, 3 * w);
    add_up(image + 3 * w * y, bw, sums + 3 * bw * y);
  }
  for (ptrdiff_t k = 0; k < bh; k++)
    for (ptrdiff_t at = 0; at < bw; at += STRIP / WIDE) {
      const ptrdiff_t count = bw - at < STRIP / WIDE ? bw - at : STRIP / WIDE;
      struct spread of, half = {0};
      down(image + 3 * BLOCK * (w * k + at), 3 * w, WIDE * count, &of);
      across(&of, &half, WIDE / 2), across(&half, &of, WIDE / 4);
      across(&of, &half, WIDE / 8), across(&half, &of, WIDE / 16);
      for (ptrdiff_t b = 0; b < count; b++)
        store(&of, sums + 3 * (bw * BLOCK * k + at + b), 3 * bw, WIDE * b, means + 3 * (bw * k + at + b), ranges + bw * k + at + b);
    }
  return OK;
}
