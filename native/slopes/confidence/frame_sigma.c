// Untouched pixels, their slopes without bias, and the slopes' standard deviation, in one pass over a frame.
#include "../../common.h"

enum { PIXELS = 64 };  // at a time: unpacked to lines, on which the arithmetic is vectors

// Inputs that do not depend on the pixel; see PreparedSigma.
struct settings {
  const float *common, *bias, *law;
  float square, steps, grows;
  int32_t law_size;
};

struct lines {
  float r[PIXELS], g[PIXELS], b[PIXELS], p[PIXELS], q[PIXELS];
  float variance[PIXELS], fraction[PIXELS], square[PIXELS];
  int32_t at_rest[PIXELS], index[PIXELS];
};

static inline void unpack(struct lines *restrict l, const float *restrict change, const float *restrict gradients,
                          const float *restrict bias, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) l->r[k] = change[3 * k], l->g[k] = change[3 * k + 1], l->b[k] = change[3 * k + 2];
  for (ptrdiff_t k = 0; k < n; k++) l->p[k] = gradients[2 * k] - bias[0], l->q[k] = gradients[2 * k + 1] - bias[1];
}

// Marks pixels whose color change is within a distance of the change that all pixels have in common.
static inline void find_at_rest(struct lines *restrict l, const struct settings *restrict s) {
  const float r = s->common[0], g = s->common[1], b = s->common[2], square = s->square;
  for (int k = 0; k < PIXELS; k++) {
    const float dr = l->r[k] - r, dg = l->g[k] - g, db = l->b[k] - b;
    l->at_rest[k] = dr * dr + dg * dg + db * db < square;
  }
}

// By the law of a slope's size: linear between the table's values, proportional beyond the last.
static inline void variance_by_law(struct lines *restrict l, const struct settings *restrict s) {
  const float end = (float)(s->law_size - 2), steps = s->steps, grows = s->grows;
  for (int k = 0; k < PIXELS; k++) {
    l->square[k] = l->p[k] * l->p[k] + l->q[k] * l->q[k];
    l->fraction[k] = sqrtf(l->square[k]) * steps;
    l->index[k] = (int32_t)smaller(l->fraction[k], end);
  }
  for (int k = 0; k < PIXELS; k++) {
    const float *at = s->law + l->index[k];
    l->variance[k] = at[0] + (l->fraction[k] - (float)l->index[k]) * (at[1] - at[0]);
  }
  for (int k = 0; k < PIXELS; k++)
    l->variance[k] = l->fraction[k] <= end ? l->variance[k] : grows * l->square[k];
}

static inline void deviation(const struct lines *restrict l, const float *restrict rest, const float *restrict place,
                             const float *restrict variance, float *restrict sigma, ptrdiff_t n) {
  if (variance == NULL)
    for (ptrdiff_t k = 0; k < n; k++) sigma[k] = sqrtf(l->at_rest[k] ? rest[k] : l->variance[k] * place[k]);
  else
    for (ptrdiff_t k = 0; k < n; k++) sigma[k] = sqrtf(l->at_rest[k] ? rest[k] : l->variance[k] * place[k] * variance[k]);
}

// Number of pixels whose slope is NaN or over the highest.
static inline int count_refused(const struct lines *restrict l, float highest, ptrdiff_t n) {
  int count = 0;
  for (ptrdiff_t k = 0; k < n; k++) count += !((fabsf(l->p[k]) <= highest) & (fabsf(l->q[k]) <= highest));
  return count;
}

// A pixel that a marker hides is not at rest.
static inline void hide_at_rest(struct lines *restrict l, const bool *restrict hidden, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) l->at_rest[k] = l->at_rest[k] & !hidden[k];
}

static inline void write_back(const struct lines *restrict l, float *restrict gradients, bool *restrict at_rest,
                              ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) gradients[2 * k] = l->p[k], gradients[2 * k + 1] = l->q[k];
  for (ptrdiff_t k = 0; k < n; k++) at_rest[k] = l->at_rest[k] != 0;
}

static inline void decide_at_rest(struct lines *restrict l, const struct settings *restrict s, const bool *hidden,
                                    const bool *given, ptrdiff_t start, ptrdiff_t n) {
  find_at_rest(l, s);
  if (given != NULL)
    for (ptrdiff_t k = 0; k < n; k++) l->at_rest[k] = given[start + k];
  else if (hidden != NULL) hide_at_rest(l, hidden + start, n);
}

// `given`: pixels at rest that were decided elsewhere, or NULL. `rest`: the variance of a slope at rest. `variance`: of each
// slope by its step, or NULL. `bias` is subtracted from the gradients. Returns how many pixels have a slope that is NaN or
// beyond the highest.
EXPORT int frame_sigma(const float *change, const bool *hidden, const bool *given, const float *common, const float *bias,
                       const float *rest, const float *place, const float *law, const float *variance, float *gradients,
                       bool *at_rest, float *sigma, float square, float steps, float grows, float highest, ptrdiff_t h,
                       ptrdiff_t w, ptrdiff_t t) {
  const struct settings s = {common, bias, law, square, steps, grows, (int32_t)t};
  struct lines l = {0};
  int refused = 0;
  if (t < 2) return WRONG_SIZE;
  for (ptrdiff_t start = 0; start < h * w; start += PIXELS) {
    const ptrdiff_t n = h * w - start < PIXELS ? h * w - start : PIXELS;
    unpack(&l, change + 3 * start, gradients + 2 * start, bias, n);
    refused += count_refused(&l, highest, n);
    decide_at_rest(&l, &s, hidden, given, start, n);
    variance_by_law(&l, &s);
    deviation(&l, rest + start, place + start, variance == NULL ? NULL : variance + start, sigma + start, n);
    write_back(&l, gradients + 2 * start, at_rest + start, n);
  }
  return refused;
}

// The same where no law of the deviation is known: which pixels are at rest, and their slopes without bias.
EXPORT int subtract_bias(const float *change, const bool *hidden, const bool *given, const float *common, const float *bias,
                         float *gradients, bool *at_rest, float square, float highest, ptrdiff_t h, ptrdiff_t w) {
  const struct settings s = {.common = common, .bias = bias, .square = square};
  struct lines l = {0};
  int refused = 0;
  for (ptrdiff_t start = 0; start < h * w; start += PIXELS) {
    const ptrdiff_t n = h * w - start < PIXELS ? h * w - start : PIXELS;
    unpack(&l, change + 3 * start, gradients + 2 * start, bias, n);
    refused += count_refused(&l, highest, n);
    decide_at_rest(&l, &s, hidden, given, start, n);
    write_back(&l, gradients + 2 * start, at_rest + start, n);
  }
  return refused;
}
