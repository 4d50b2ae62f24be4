// A frame's maps averaged over the pixels of a coarse grid.
#include "../common.h"

enum { WIDEST = 14 };  // pixels that a coarse one covers along an axis, parts of pixels included

// The pixels that a coarse pixel covers along an axis, and the fraction of it that each makes up.
struct cover {
  int32_t first, count;
  float share[WIDEST];
};

enum { COVER_WORDS = sizeof(struct cover) / sizeof(float) };

static bool covers_fit(ptrdiff_t coarse, ptrdiff_t pixels) { return coarse >= 1 && pixels <= (WIDEST - 2) * coarse; }

static struct cover cover_of(ptrdiff_t at, ptrdiff_t coarse, ptrdiff_t pixels) {
  const double size = (double)pixels / (double)coarse, from = (double)at * size, to = (double)(at + 1) * size;
  struct cover c = {(int32_t)from, 0, {0}};
  for (ptrdiff_t k = c.first; k < pixels && c.count < WIDEST && to - (double)k > 1e-6; k++) {
    const double low = (double)k > from ? (double)k : from, high = (double)(k + 1) < to ? (double)(k + 1) : to;
    c.share[c.count++] = (float)((high - low) / size);
  }
  return c;
}

static const struct cover *covers_in(float *work, ptrdiff_t coarse, ptrdiff_t pixels) {
  struct cover *covers = (struct cover *)work;
  for (ptrdiff_t j = 0; j < coarse; j++) covers[j] = cover_of(j, coarse, pixels);
  return covers;
}

// Sums over the covered pixels of a line that holds `channels` values for each pixel.
static inline void sum_covered(const float *restrict line, const struct cover *covers, ptrdiff_t channels, float *restrict out,
                               ptrdiff_t coarse) {
  for (ptrdiff_t j = 0; j < coarse; j++) {
    const struct cover *c = covers + j;
    const float *from = line + c->first * channels;
    for (ptrdiff_t channel = 0; channel < channels; channel++) {
      float total = 0;
      if (c->count == 4)  // the usual: no loop, no branch
        total = (c->share[0] * from[channel] + c->share[1] * from[channels + channel]) +
                (c->share[2] * from[2 * channels + channel] + c->share[3] * from[3 * channels + channel]);
      else
        for (ptrdiff_t k = 0; k < c->count; k++) total += c->share[k] * from[k * channels + channel];
      out[j * channels + channel] = total;
    }
  }
}

static void add_row(float *restrict line, const float *restrict values, float share, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) line[j] += share * values[j];
}

static void add_weighted(float *restrict line, const float *restrict slopes, const float *restrict weights, float share, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) {
    line[2 * j] += share * weights[j] * slopes[2 * j];
    line[2 * j + 1] += share * weights[j] * slopes[2 * j + 1];
  }
}

static void add_chosen(float *restrict line, const bool *restrict chosen, float share, ptrdiff_t w) {
  for (ptrdiff_t j = 0; j < w; j++) line[j] += share * (float)chosen[j];
}

// Means of slopes, times weights where there are some.
EXPORT int coarse_slopes(const float *slopes, const float *weights, float *work, float *coarse, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n,
                         ptrdiff_t rows, ptrdiff_t columns) {
  if (!covers_fit(rows, h) || !covers_fit(columns, w) || n < columns * COVER_WORDS + 2 * w) return WRONG_SIZE;
  const struct cover *across = covers_in(work, columns, w);
  float *line = work + columns * COVER_WORDS;
  for (ptrdiff_t i = 0; i < rows; i++) {
    const struct cover down = cover_of(i, rows, h);
    memset(line, 0, (size_t)(2 * w) * sizeof *line);
    for (ptrdiff_t k = 0; k < down.count; k++) {
      const float *row = slopes + (down.first + k) * 2 * w;
      if (weights) add_weighted(line, row, weights + (down.first + k) * w, down.share[k], w);
      else add_row(line, row, down.share[k], 2 * w);
    }
    sum_covered(line, across, 2, coarse + i * columns * 2, columns);
  }
  return OK;
}

// Means of weights and the share of pixels that are chosen.
EXPORT int coarse_trust(const float *weights, const bool *chosen, float *work, float *trust, float *share, ptrdiff_t h, ptrdiff_t w,
                        ptrdiff_t n, ptrdiff_t rows, ptrdiff_t columns) {
  if (!covers_fit(rows, h) || !covers_fit(columns, w) || n < columns * COVER_WORDS + 2 * w) return WRONG_SIZE;
  const struct cover *across = covers_in(work, columns, w);
  float *line = work + columns * COVER_WORDS, *count = line + w;
  for (ptrdiff_t i = 0; i < rows; i++) {
    const struct cover down = cover_of(i, rows, h);
    memset(line, 0, (size_t)(2 * w) * sizeof *line);
    for (ptrdiff_t k = 0; k < down.count; k++) {
      const ptrdiff_t at = (down.first + k) * w;
      if (weights) add_row(line, weights + at, down.share[k], w);
      add_chosen(count, chosen + at, down.share[k], w);
    }
    if (weights) sum_covered(line, across, 1, trust + i * columns, columns);
    else
      for (ptrdiff_t j = 0; j < columns; j++) trust[i * columns + j] = 1;
    sum_covered(count, across, 1, share + i * columns, columns);
  }
  return OK;
}
