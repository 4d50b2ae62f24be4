// Sums over the pixels of a block, and from the variance of blocks the sigma of pixels.
#include "../common.h"

// Planes of the sums; for each slope two more follow: weight times sigma, and its square.
enum { INSIDE, WEIGHT, SQUARE, HOLD, REGION, FIRST };

struct maps {
  const float *sigma, *weights, *anchor;
  const bool *mask, *region;
  ptrdiff_t w, slopes;
};

static void add_row(const struct maps *of, ptrdiff_t i, float floor, float *lines) {
  const ptrdiff_t w = of->w;
  const bool *restrict mask = of->mask + i * w, *restrict region = of->region + i * w;
  const float *restrict weights = of->weights + i * w, *restrict anchor = of->anchor + i * w;
  float *restrict inside = lines + INSIDE * w, *restrict total = lines + WEIGHT * w, *restrict square = lines + SQUARE * w;
  float *restrict hold = lines + HOLD * w, *restrict zero = lines + REGION * w;
  INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) {
    const float in = mask[j], weight = weights[j] >= floor ? in * weights[j] : 0;
    total[j] += weight, square[j] += weight * weight, hold[j] += in * anchor[j];
  }
  INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) inside[j] += (float)mask[j], zero[j] += (float)(mask[j] & region[j]);
}

static void add_slopes(const struct maps *of, ptrdiff_t i, ptrdiff_t slope, float floor, float *lines) {
  const ptrdiff_t w = of->w, step = of->slopes;
  const bool *restrict mask = of->mask + i * w;
  const float *restrict weights = of->weights + i * w, *restrict sigma = of->sigma + i * w * step + slope;
  float *restrict moved = lines + (FIRST + 2 * slope) * w, *restrict square = moved + w;
  INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) {
    const float error = weights[j] >= floor ? mask[j] * weights[j] * sigma[step * j] : 0;
    moved[j] += error, square[j] += error * error;
  }
}

EXPORT int sum_blocks(const float *sigma, const float *weights, const bool *mask, const float *anchor, const bool *region, float floor,
                      int64_t block, float *work, float *sums, ptrdiff_t h, ptrdiff_t w, ptrdiff_t slopes, ptrdiff_t planes,
                      ptrdiff_t rows, ptrdiff_t columns) {
  if (planes != FIRST + 2 * slopes || rows * block < h || columns * block < w) return WRONG_SIZE;
  const struct maps maps = {sigma, weights, anchor, mask, region, w, slopes};
  for (ptrdiff_t row = 0; row < rows; row++) {
    memset(work, 0, planes * w * sizeof(float));
    for (ptrdiff_t i = row * block; i < h && i < (row + 1) * block; i++) {
      add_row(&maps, i, floor, work);
      for (ptrdiff_t slope = 0; slope < slopes; slope++) add_slopes(&maps, i, slope, floor, work);
    }
    for (ptrdiff_t p = 0; p < planes; p++)
      for (ptrdiff_t k = 0; k < columns; k++) {
        float total = 0;
        for (ptrdiff_t j = k * block; j < w && j < (k + 1) * block; j++) total += work[p * w + j];
        sums[(p * rows + row) * columns + k] = total;
      }
  }
  return OK;
}

// Into lines of w + 2: whether slopes of a row are trusted, and 1 over their sigma there.
static void look_at_row(const float *restrict weights, const float *restrict sigma, ptrdiff_t step, float floor,
                        float *restrict trusted, float *restrict certain, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) {
    const float one = weights[j] >= floor ? 1.0f : 0.0f;
    trusted[j + 1] = one, certain[j + 1] = one / sigma[step * j];
  }
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

// Where an anchor holds, relative to the weights of 3x3 pixels: how much is left of what blocks do not see (see
// `fading_within_blocks`), and how far these pixels follow what is around them, by ties over ties and anchor.
static void hold(const float *restrict weights, const float *restrict anchor, const float *restrict p, float *restrict faded,
                 float *restrict followed, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) {
    const float x = 9 * anchor[j] / (weights[j] + weights[j + 1] + weights[j + 2]);
    faded[j] = (1 + p[0] * x) / (1 + x * (p[1] + x * (p[2] + x * p[3])));
    followed[j] = 4 / (4 + x);
  }
}

static void add_lines(float *restrict sum, const float *restrict a, const float *restrict b, const float *restrict c, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) sum[j] = a[j] + b[j] + c[j];
}

// The variance of blocks reaches a pixel that an anchor holds by way of its neighbours, and from them by its own ties.
static void follow(const float *restrict up, const float *restrict here, const float *restrict down, const float *restrict anchor,
                   const float *restrict followed, float *restrict total, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) {
    const float a = here[j], e = here[j + 1], b = here[j + 2], c = up[j + 1], d = down[j + 1];
    const float ties = 2 * e * ((a / (e + a) + b / (e + b)) + (c / (e + c) + d / (e + d)));
    const float share = followed[j] * ties / (ties + anchor[j]);
    total[j] *= share * share;
  }
}

EXPORT int sigma_of_pixels(const float *variance, const float *sigma, const float *within, const float *fading, const float *weights,
                           float floor, const float *anchor, float *work, float *out, ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t h, ptrdiff_t w,
                           ptrdiff_t slopes, ptrdiff_t line) {
  if (rows < h || columns < w || line != w + 2 || slopes < 1 || slopes > 2) return WRONG_SIZE;
  float *trusted[3], *certain[2][3], *padded[3], *count = work + 12 * line, *sums = work + 13 * line, *faded = work + 14 * line, *followed = work + 15 * line;
  for (int k = 0; k < 3; k++) trusted[k] = work + k * line, certain[0][k] = work + (3 + k) * line, certain[1][k] = work + (6 + k) * line, padded[k] = work + (9 + k) * line;
  memset(work, 0, 16 * line * sizeof(float));
  for (ptrdiff_t j = 0; j < w; j++) faded[j] = 1;
  for (ptrdiff_t i = -1; i < h; i++) {  // the row below the current one comes into the lines of the one before last
    const ptrdiff_t below = i + 1;
    for (ptrdiff_t s = 0; s < slopes; s++) {
      if (below < h) look_at_row(weights + below * w, sigma + below * w * slopes + s, slopes, floor, trusted[below % 3], certain[s][below % 3], w);
      else memset(trusted[below % 3], 0, line * sizeof(float)), memset(certain[s][below % 3], 0, line * sizeof(float));
    }
    if (anchor && below < h) pad_row(weights + below * w, floor, padded[below % 3], w);
    if (i < 0) continue;
    float *total = out + i * w;
    memcpy(total, variance + i * columns, w * sizeof(float));
    if (anchor) {
      const float *up = padded[i > 0 ? (i + 2) % 3 : 0], *here = padded[i % 3], *low = padded[below < h ? below % 3 : i % 3];
      add_lines(sums, up, here, low, line);
      hold(sums, anchor + i * w, fading, faded, followed, w);
      follow(up, here, low, anchor + i * w, followed, total, w);
    }
    add_lines(count, trusted[(i + 2) % 3], trusted[i % 3], trusted[below % 3], line);
    for (ptrdiff_t s = 0; s < slopes; s++) {
      add_lines(sums, certain[s][(i + 2) % 3], certain[s][i % 3], certain[s][below % 3], line);
      add_within(count, sums, faded, slopes == 2 ? within[s] : within[0] + within[1], total, w);
    }
    for (ptrdiff_t j = 0; j < w; j++) total[j] = sqrtf(total[j]);
  }
  return OK;
}
