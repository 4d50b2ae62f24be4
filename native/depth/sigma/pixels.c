// From the variance of blocks the sigma of pixels.
#include "../../bilinear.h"

// The part of the variance from a pixel's own slopes, beyond the variance of its block.
struct slopes {
  const float *sigma, *weights;
  const bool *at_rest;  // NULL: nowhere
  float contact_white, rest_white, floor;
  ptrdiff_t count;
};

// Into lines of w + 2: whether slopes of row i are trusted, and 1 over the white part of their sigma there.
static void look_at_row(const struct slopes *of, ptrdiff_t i, ptrdiff_t slope, float *restrict trusted, float *restrict certain,
                        ptrdiff_t w) {
  const float *restrict weights = of->weights + i * w, *restrict sigma = of->sigma + i * w * of->count + slope;
  const float floor = of->floor, contact = 1 / of->contact_white, still = 1 / of->rest_white;
  const ptrdiff_t step = of->count;
  for (ptrdiff_t j = 0; j < w; j++) trusted[j + 1] = weights[j] >= floor ? 1.0f : 0.0f;
  if (step == 1)
    for (ptrdiff_t j = 0; j < w; j++) certain[j + 1] = trusted[j + 1] * contact / sigma[j];
  else
    for (ptrdiff_t j = 0; j < w; j++) certain[j + 1] = trusted[j + 1] * contact / sigma[step * j];
  if (!of->at_rest) return;
  const bool *restrict at_rest = of->at_rest + i * w;
  const float ratio = still / contact;
  for (ptrdiff_t j = 0; j < w; j++) certain[j + 1] *= at_rest[j] ? ratio : 1.0f;
}

// Add what blocks do not see: the usual sigma of the trusted among 3x3 pixels, their harmonic mean.
static void add_within(const float *restrict trusted, const float *restrict certain, const float *restrict faded, float share,
                       float *restrict total, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) {
    const float usual = (trusted[j] + trusted[j + 1] + trusted[j + 2]) / (certain[j] + certain[j + 1] + certain[j + 2] + 1e-30f);
    total[j] += faded[j] * share * usual * usual;
  }
}

// A row of weights, `floor` at least, in a line of w + 2 whose ends repeat the border.
static void pad_row(const float *restrict weights, float floor, float *restrict padded, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) padded[j + 1] = larger(weights[j], floor);
  padded[0] = padded[1], padded[w + 1] = padded[w];
}

// The coupling of two pixels: the harmonic mean of their weights.
static inline void tie(const float *restrict a, const float *restrict b, float *restrict ties, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) ties[j] = 2 * a[j] * (b[j] / (a[j] + b[j]));
}

// For an anchor relative to the weights of 3x3 pixels: the fraction that is left of what blocks do not resolve (see
// `fading_within_blocks`). The variance of blocks reaches these pixels by ties over ties and anchor, of 3x3 pixels and then their own.
static void hold(const float *restrict weights, const float *restrict anchor, const float *restrict p, const float *restrict across,
                 const float *restrict above, const float *restrict below, float *restrict faded, float *restrict total, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) {
    const float x = 9 * anchor[j] / (weights[j] + weights[j + 1] + weights[j + 2]);
    const float ties = (across[j] + across[j + 1]) + (above[j] + below[j]);
    const float share = 4 * ties / ((4 + x) * (ties + anchor[j]));
    faded[j] = (1 + p[0] * x) / (1 + x * (p[1] + x * (p[2] + x * p[3])));
    total[j] *= share * share;
  }
}

static void add_lines(float *restrict sum, const float *restrict a, const float *restrict b, const float *restrict c, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) sum[j] = a[j] + b[j] + c[j];
}

enum { LINES = 22 };  // of w + 2 floats

// `variance` (rows, columns) of blocks of `block` x `block` pixels becomes that of pixels, bilinearly.
EXPORT int sigma_of_pixels(const float *variance, const float *sigma, const bool *at_rest, const float *white, const float *within,
                           const float *fading, const float *weights, float floor, const float *anchor, int64_t block, float *work,
                           float *out, ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t h, ptrdiff_t w, ptrdiff_t slopes, ptrdiff_t line) {
  if (block < 1 || rows * block < h || columns * block < w || line != w + 2 || slopes < 1 || slopes > 2) return WRONG_SIZE;
  const struct slopes of = {sigma, weights, at_rest, white[0], white[1], floor, slopes};
  float *lines[LINES], **trusted = lines, **padded = lines + 3, **certain[] = {lines + 6, lines + 9};
  memset(work, 0, LINES * line * sizeof(float));
  for (int k = 0; k < LINES; k++) lines[k] = work + k * line;
  float *count = lines[12], *sums = lines[13], *faded = lines[14], *across = lines[15], *above = lines[16], *below = lines[17];
  struct rows_between blocks = {variance, rows, columns, w, -1, (int32_t *)lines[18], lines[19], lines[20], lines[21]};
  places_in_row(w, 1.0 / (double)block, columns, (int32_t *)lines[18], lines[19]);
  for (ptrdiff_t j = 0; j < w; j++) faded[j] = 1;
  for (ptrdiff_t i = -1; i < h; i++) {  // the row below the current one comes into the lines of the one before last
    const ptrdiff_t next = i + 1, up = (i + 2) % 3, here = (i + 3) % 3, low = next % 3;
    for (ptrdiff_t s = 0; s < slopes; s++) {
      if (next < h) look_at_row(&of, next, s, trusted[low], certain[s][low], w);
      else memset(trusted[low], 0, line * sizeof(float)), memset(certain[s][low], 0, line * sizeof(float));
    }
    if (anchor && next < h) pad_row(weights + next * w, floor, padded[low], w);
    if (i < 0) continue;
    float fraction, *total = out + i * w;
    hold_rows(&blocks, between(i, 1.0 / (double)block, rows, &fraction));
    for (ptrdiff_t j = 0; j < w; j++) total[j] = blocks.upper[j] + fraction * (blocks.lower[j] - blocks.upper[j]);
    if (anchor) {
      const float *restrict row = padded[here], *before = i > 0 ? padded[up] : row, *after = next < h ? padded[low] : row;
      float *const taken = above;
      if (i == 0) tie(row + 1, row + 1, below, w);
      above = below, below = taken;
      tie(row + 1, after + 1, below, w);
      tie(row, row + 1, across, w + 1);
      add_lines(sums, before, row, after, line);
      hold(sums, anchor + i * w, fading, across, above, below, faded, total, w);
    }
    add_lines(count, trusted[up], trusted[here], trusted[low], line);
    for (ptrdiff_t s = 0; s < slopes; s++) {
      add_lines(sums, certain[s][up], certain[s][here], certain[s][low], line);
      add_within(count, sums, faded, slopes == 2 ? within[s] : within[0] + within[1], total, w);
    }
    for (ptrdiff_t j = 0; j < w; j++) total[j] = sqrtf(total[j]);
  }
  return OK;
}
