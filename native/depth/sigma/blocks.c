// Sums over the pixels of a block, and what they say of its errors.
#include "../../common.h"

// Planes of the sums; for each slope two more follow: weight times sigma, and its square.
enum { INSIDE, WEIGHT, SQUARE, HOLD, REGION, REST, FIRST };

struct maps {
  const float *sigma, *weights, *anchor;
  const bool *mask, *region, *at_rest;
  ptrdiff_t w, slopes;
};

static void add_row(const struct maps *of, ptrdiff_t i, float floor, float *lines) {
  const ptrdiff_t w = of->w;
  const float *restrict weights = of->weights + i * w, *restrict anchor = of->anchor + i * w;
  float *restrict total = lines + WEIGHT * w, *restrict square = lines + SQUARE * w, *restrict hold = lines + HOLD * w;
  if (!of->mask) {
    INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) {
      const float weight = weights[j] >= floor ? weights[j] : 0;
      total[j] += weight, square[j] += weight * weight, hold[j] += anchor[j];
    }
    return;
  }
  const bool *restrict mask = of->mask + i * w;
  float *restrict inside = lines + INSIDE * w;
  INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) {
    const float in = mask[j], weight = weights[j] >= floor ? in * weights[j] : 0;
    total[j] += weight, square[j] += weight * weight, hold[j] += in * anchor[j], inside[j] += in;
  }
}

static void add_chosen(const bool *chosen, const bool *mask, float *restrict line, ptrdiff_t w) {
  if (chosen && !mask)
    INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) line[j] += (float)chosen[j];
  if (chosen && mask)
    INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) line[j] += (float)(chosen[j] & mask[j]);
}

static void add_slopes(const struct maps *of, ptrdiff_t i, ptrdiff_t slope, float floor, float *lines) {
  const ptrdiff_t w = of->w, step = of->slopes;
  const float *restrict weights = of->weights + i * w, *restrict sigma = of->sigma + i * w * step + slope;
  float *restrict moved = lines + (FIRST + 2 * slope) * w, *restrict square = moved + w;
  const bool *restrict mask = of->mask ? of->mask + i * w : NULL;
  if (mask)
    INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) {
      const float error = weights[j] >= floor ? mask[j] * weights[j] * sigma[step * j] : 0;
      moved[j] += error, square[j] += error * error;
    }
  else
    INDEPENDENT for (ptrdiff_t j = 0; j < w; j++) {
      const float error = weights[j] >= floor ? weights[j] * sigma[step * j] : 0;
      moved[j] += error, square[j] += error * error;
    }
}

// Sum of the n values of a block in a line, in several partial sums, so that none waits for the one before.
static inline float sum_of(const float *line, ptrdiff_t n) {
  if (n == 6) return ((line[0] + line[1]) + (line[2] + line[3])) + (line[4] + line[5]);
  float total = 0;
  for (ptrdiff_t j = 0; j < n; j++) total += line[j];
  return total;
}

static ptrdiff_t pixels_from(ptrdiff_t block, ptrdiff_t size, ptrdiff_t pixels) {
  const ptrdiff_t left = pixels - block * size;
  return left < 0 ? 0 : left < size ? left : size;
}

// Without a mask all pixels are inside it, without zero pixels or rest there are none.
EXPORT int sum_blocks(const float *sigma, const float *weights, const bool *mask, const float *anchor, const bool *region, const bool *at_rest,
                      float floor, int64_t block, float *work, float *sums, ptrdiff_t h, ptrdiff_t w, ptrdiff_t slopes,
                      ptrdiff_t planes, ptrdiff_t rows, ptrdiff_t columns) {
  if (planes != FIRST + 2 * slopes || rows * block < h || columns * block < w) return WRONG_SIZE;
  const struct maps maps = {sigma, weights, anchor, mask, region, at_rest, w, slopes};
  for (ptrdiff_t row = 0; row < rows; row++) {
    const ptrdiff_t high = pixels_from(row, block, h);
    memset(work, 0, planes * w * sizeof(float));
    for (ptrdiff_t i = row * block; i < row * block + high; i++) {
      add_row(&maps, i, floor, work);
      add_chosen(region ? region + i * w : NULL, mask ? mask + i * w : NULL, work + REGION * w, w);
      add_chosen(at_rest ? at_rest + i * w : NULL, NULL, work + REST * w, w);
      for (ptrdiff_t slope = 0; slope < slopes; slope++) add_slopes(&maps, i, slope, floor, work);
    }
    for (ptrdiff_t p = 0; p < planes; p++)
      for (ptrdiff_t k = 0; k < columns; k++) {
        const ptrdiff_t wide = pixels_from(k, block, w);
        const float all = (float)(high * wide);
        sums[(p * rows + row) * columns + k] = p == INSIDE && !mask ? all : sum_of(work + p * w + k * block, wide);
      }
  }
  return OK;
}

// The parts of slope errors; see `ErrorParts`.
struct parts {
  float share, rest_share, power;
};

// From the sums (planes, rows, columns): the mean weight of a block's pixels; the standard deviation of its weighted mean slopes by
// independent errors and by common ones; and the usual sigma of its pixels.
//
// Holes make independent errors go round: worse by the unevenness of the weights in the block.
EXPORT int errors_of_blocks(const float *sums, float *weight, float *white, float *common, float *usual, int64_t block, float share,
                            float rest_share, float power, int64_t h, int64_t w, ptrdiff_t planes, ptrdiff_t rows, ptrdiff_t columns) {
  const ptrdiff_t size = rows * columns, slopes = (planes - FIRST) / 2;
  if (planes != FIRST + 2 * slopes || slopes < 1 || slopes > 2) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < size; k++) {
    const float *at = sums + k;
    const float count = at[INSIDE * size], total = larger(at[WEIGHT * size], 1e-30f);
    const ptrdiff_t pixels = pixels_from(k / columns, block, h) * pixels_from(k % columns, block, w);
    const float rest = pixels ? at[REST * size] / (float)pixels : 0;
    const float uneven = sqrtf(count * at[SQUARE * size]) / total;
    const float of_white = sqrtf((1 - rest) * (1 - share) + rest * (1 - rest_share) * power) * (uneven == 0 ? 1 : uneven) / total;
    const float of_common = sqrtf((1 - rest) * share + rest * rest_share);
    weight[k] = at[WEIGHT * size] / larger(count, 1);
    for (ptrdiff_t s = 0; s < 2; s++) {
      const float *moved = at + (FIRST + 2 * (s < slopes ? s : 0)) * size;
      usual[2 * k + s] = moved[0] / total;
      white[2 * k + s] = sqrtf(moved[size]) * of_white;
      common[2 * k + s] = usual[2 * k + s] * of_common;
    }
  }
  return OK;
}
