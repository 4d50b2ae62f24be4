// Untouched pixels, the slopes without their bias, and the solver's weights, in one pass over a frame.
#include "../../select.h"
#include "outlier.h"

enum { PIXELS = 64 };  // at a time: unpacked to lines, on which the arithmetic is vectors

struct lines {
  float r[PIXELS], g[PIXELS], b[PIXELS], p[PIXELS], q[PIXELS];
  int32_t at_rest[PIXELS];
};

static inline void unpack(struct lines *restrict l, const float *restrict change, const float *restrict gradients,
                          const float *restrict bias, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) l->r[k] = change[3 * k], l->g[k] = change[3 * k + 1], l->b[k] = change[3 * k + 2];
  for (ptrdiff_t k = 0; k < n; k++) l->p[k] = gradients[2 * k] - bias[0], l->q[k] = gradients[2 * k + 1] - bias[1];
}

// Marks pixels whose color change is within a distance of the change that all pixels have in common.
static inline void find_at_rest(struct lines *restrict l, const float *restrict common, float square) {
  const float r = common[0], g = common[1], b = common[2];
  for (int k = 0; k < PIXELS; k++) {
    const float dr = l->r[k] - r, dg = l->g[k] - g, db = l->b[k] - b;
    l->at_rest[k] = dr * dr + dg * dg + db * db < square;
  }
}

// Number of pixels whose slope is NaN or over the highest.
static inline int count_refused(const struct lines *restrict l, float highest, ptrdiff_t n) {
  int count = 0;
  for (ptrdiff_t k = 0; k < n; k++) count += !((fabsf(l->p[k]) <= highest) & (fabsf(l->q[k]) <= highest));
  return count;
}

static inline void write_back(const struct lines *restrict l, float *restrict gradients, bool *restrict at_rest, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) gradients[2 * k] = l->p[k], gradients[2 * k + 1] = l->q[k];
  for (ptrdiff_t k = 0; k < n; k++) at_rest[k] = l->at_rest[k] != 0;
}

// Marks pixels of every `step`-th row and column as `find_at_rest` does, unless they are hidden; the others of `near` stay as they
// are. Returns how many they are.
static int32_t near_common(const float *change, const bool *hidden, const float *common, bool *near, float square, int64_t step,
                           ptrdiff_t h, ptrdiff_t w) {
  const float r = common[0], g = common[1], b = common[2];
  int32_t count = 0;
  for (ptrdiff_t y = 0; y < h; y += step)
    for (ptrdiff_t x = 0; x < w; x += step) {
      const ptrdiff_t k = y * w + x;
      const float dr = change[3 * k] - r, dg = change[3 * k + 1] - g, db = change[3 * k + 2] - b;
      near[k] = dr * dr + dg * dg + db * db < square && !(hidden != NULL && hidden[k]);
      count += near[k];
    }
  return count;
}

// The pixels at rest, and the gradients without their bias, the median slope of these pixels. They are `given`, or else those whose
// color change is within the root of `square` of the median of all, and which no marker hides. Medians are over every `step`-th row
// and column, that of the change over every `coarse`-th. Returns how many of these pixels are at rest; if they are less than the
// `share` of all, the gradients stay. `refused`: how many pixels have a slope that is NaN or beyond the highest.
EXPORT int slopes_at_rest(const float *change, const bool *hidden, const bool *given, float *gradients, bool *at_rest,
                          int32_t *refused, float *work, float square, float highest, double share, int64_t coarse, int64_t step,
                          ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  float common[3] = {0}, bias[2];
  struct lines l = {0};
  *refused = 0;
  if (step < 1 || coarse < 1 || n < 2 * sampled(h, w, step) || n < 2 * sampled(h, w, coarse)) return WRONG_SIZE;
  if (given == NULL) {
    medians_where(change, NULL, coarse, work, common, h, w, 3, n);
    const int32_t count = near_common(change, hidden, common, at_rest, square, step, h, w);
    if ((double)count / (double)sampled(h, w, step) < share) return count;
  }
  const int count = medians_where(gradients, given == NULL ? at_rest : given, step, work, bias, h, w, 2, n);
  for (ptrdiff_t start = 0; start < h * w; start += PIXELS) {
    const ptrdiff_t size = h * w - start < PIXELS ? h * w - start : PIXELS;
    unpack(&l, change + 3 * start, gradients + 2 * start, bias, size);
    *refused += count_refused(&l, highest, size);
    find_at_rest(&l, common, square);
    if (given != NULL)
      for (ptrdiff_t k = 0; k < size; k++) l.at_rest[k] = given[start + k];
    else if (hidden != NULL)
      for (ptrdiff_t k = 0; k < size; k++) l.at_rest[k] = l.at_rest[k] & !hidden[start + k];
    write_back(&l, gradients + 2 * start, at_rest + start, size);
  }
  return count;
}

// A weight says "no slope here" and nothing else: full^2 / (full^2 + outlier^2), `least` where nothing was seen. `residual` is of
// the forward response's step, `of_model` a color model's own deviation; either may be NULL.
EXPORT int slope_weights(const float *residual, const float *of_model, const bool *unseen, float *weight, float outlier,
                         float unknown, float full, float least, ptrdiff_t count) {
  const float square = full * full;
  if (!(outlier > 0) || !(full > 0)) return WRONG_SIZE;
  for (ptrdiff_t start = 0; start < count; start += PIXELS) {
    const int n = (int)(count - start < PIXELS ? count - start : PIXELS);
    float off[PIXELS] = {0};
    variance_of_outliers(off, residual == NULL ? NULL : residual + start, outlier, unknown, n);
    if (of_model != NULL)
      for (int k = 0; k < n; k++) off[k] += larger(of_model[start + k] * of_model[start + k] - square, 0);
    for (int k = 0; k < n; k++) weight[start + k] = larger(square / (square + off[k]), least);
    if (unseen != NULL)
      for (int k = 0; k < n; k++) weight[start + k] = unseen[start + k] ? least : weight[start + k];
  }
  return OK;
}
