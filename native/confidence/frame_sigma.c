// Which pixels are untouched, their slopes without bias, and the slopes' deviation by law and colour: one pass over a frame.
#include "../common.h"

enum { PIXELS = 64 };  // at a time: unpacked to lines, on which the arithmetic is vectors

// What does not depend on the pixel; see PreparedSigma.
struct settings {
  const float *common, *bias, *law, *gamut, *low;
  float square, steps, grows, rest, bins_per_change, worth, unlearnt;
  int32_t law_size, gamut_size;
};

struct lines {
  float r[PIXELS], g[PIXELS], b[PIXELS], p[PIXELS], q[PIXELS];
  float beyond[PIXELS], variance[PIXELS], fraction[PIXELS], square[PIXELS];
  int32_t untouched[PIXELS], index[PIXELS];
};

static inline void unpack(struct lines *restrict l, const float *restrict change, const float *restrict gradients,
                          const float *restrict bias, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) l->r[k] = change[3 * k], l->g[k] = change[3 * k + 1], l->b[k] = change[3 * k + 2];
  for (ptrdiff_t k = 0; k < n; k++) l->p[k] = gradients[2 * k] - bias[0], l->q[k] = gradients[2 * k + 1] - bias[1];
}

// Where the color change is within a distance of what all pixels have in common.
static inline void find_untouched(struct lines *restrict l, const struct settings *restrict s) {
  const float r = s->common[0], g = s->common[1], b = s->common[2], square = s->square;
  for (int k = 0; k < PIXELS; k++) {
    const float dr = l->r[k] - r, dg = l->g[k] - g, db = l->b[k] - b;
    l->untouched[k] = dr * dr + dg * dg + db * db < square;
  }
}

// Distance of each colour from those of the training presses, as a slope: the nearest bin's, and the way there.
static inline void distance_from_gamut(struct lines *restrict l, const struct settings *restrict s) {
  if (s->gamut == NULL) {
    memset(l->beyond, 0, sizeof l->beyond);
    return;
  }
  const float scale = s->bins_per_change, last = (float)(s->gamut_size - 1);
  const float r0 = s->low[0] * scale, g0 = s->low[1] * scale, b0 = s->low[2] * scale;
  const int32_t size = s->gamut_size;
  for (int k = 0; k < PIXELS; k++) {
    const float r = l->r[k] * scale - r0, g = l->g[k] * scale - g0, b = l->b[k] * scale - b0;
    const float i = clamp(r, 0, last), j = clamp(g, 0, last), m = clamp(b, 0, last);
    l->beyond[k] = (r - i) * (r - i) + (g - j) * (g - j) + (b - m) * (b - m);
    l->index[k] = ((int32_t)(i + 0.5f) * size + (int32_t)(j + 0.5f)) * size + (int32_t)(m + 0.5f);
  }
  for (int k = 0; k < PIXELS; k++) l->variance[k] = s->gamut[l->index[k]];
  for (int k = 0; k < PIXELS; k++) l->beyond[k] = l->variance[k] + s->worth * sqrtf(l->beyond[k]);
}

// Variance of each slope by the law of its size: linear between the table's values, proportional beyond the last.
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

// Slopes beyond the steepest that the presses showed at their place: a variance by how far beyond at least.
static inline void variance_of_steepness(struct lines *restrict l, const struct settings *restrict s,
                                         const float *restrict place, const float *restrict per_steepest, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) {
    const float slope = sqrtf(l->square[k]);
    const float least = s->unlearnt * slope * larger(slope * per_steepest[k] - 1, 0);
    l->variance[k] = larger(l->variance[k] * place[k], least * least);
  }
}

static inline void deviation(const struct lines *restrict l, const struct settings *restrict s,
                             float *restrict sigma, ptrdiff_t n) {
  const float rest = s->rest;
  for (ptrdiff_t k = 0; k < n; k++)
    sigma[k] = sqrtf((l->untouched[k] ? rest : l->variance[k]) + l->beyond[k] * l->beyond[k]);
}

// How many pixels have a slope that is NaN or beyond the highest.
static inline int count_refused(const struct lines *restrict l, float highest, ptrdiff_t n) {
  int count = 0;
  for (ptrdiff_t k = 0; k < n; k++) count += !((fabsf(l->p[k]) <= highest) & (fabsf(l->q[k]) <= highest));
  return count;
}

// A pixel that a marker hides is not untouched.
static inline void hide_untouched(struct lines *restrict l, const bool *restrict hidden, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) l->untouched[k] = l->untouched[k] & !hidden[k];
}

static inline void write_back(const struct lines *restrict l, float *restrict gradients, bool *restrict untouched,
                              ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) gradients[2 * k] = l->p[k], gradients[2 * k + 1] = l->q[k];
  for (ptrdiff_t k = 0; k < n; k++) untouched[k] = l->untouched[k] != 0;
}

static inline void decide_untouched(struct lines *restrict l, const struct settings *restrict s, const bool *hidden,
                                    const bool *given, ptrdiff_t start, ptrdiff_t n) {
  find_untouched(l, s);
  if (given != NULL)
    for (ptrdiff_t k = 0; k < n; k++) l->untouched[k] = given[start + k];
  else if (hidden != NULL) hide_untouched(l, hidden + start, n);
}

// `given`: untouched pixels that were decided elsewhere, or NULL. `bias` is subtracted from the gradients. Returns how many
// pixels have a slope that is NaN or beyond the highest.
EXPORT int frame_sigma(const float *change, const bool *hidden, const bool *given, const float *common,
                       const float *bias, const float *place, const float *per_steepest, const float *law,
                       const float *gamut, const float *low, float *gradients, bool *untouched, float *sigma,
                       float square, float steps, float grows, float rest, float bins_per_change, float worth,
                       float unlearnt, float highest, ptrdiff_t h, ptrdiff_t w, ptrdiff_t t, ptrdiff_t g) {
  const struct settings s = {common, bias, law, gamut, low, square, steps, grows, rest, bins_per_change,
                             worth, unlearnt, (int32_t)t, (int32_t)g};
  struct lines l = {0};
  int refused = 0;
  if (t < 2) return WRONG_SIZE;
  for (ptrdiff_t start = 0; start < h * w; start += PIXELS) {
    const ptrdiff_t n = h * w - start < PIXELS ? h * w - start : PIXELS;
    unpack(&l, change + 3 * start, gradients + 2 * start, bias, n);
    refused += count_refused(&l, highest, n);
    decide_untouched(&l, &s, hidden, given, start, n);
    distance_from_gamut(&l, &s);
    variance_by_law(&l, &s);
    variance_of_steepness(&l, &s, place + start, per_steepest + start, n);
    deviation(&l, &s, sigma + start, n);
    write_back(&l, gradients + 2 * start, untouched + start, n);
  }
  return refused;
}

// The same where no law of the deviation is known: which pixels are untouched, and their slopes without bias.
EXPORT int subtract_bias(const float *change, const bool *hidden, const bool *given, const float *common, const float *bias,
                         float *gradients, bool *untouched, float square, float highest, ptrdiff_t h, ptrdiff_t w) {
  const struct settings s = {.common = common, .bias = bias, .square = square};
  struct lines l = {0};
  int refused = 0;
  for (ptrdiff_t start = 0; start < h * w; start += PIXELS) {
    const ptrdiff_t n = h * w - start < PIXELS ? h * w - start : PIXELS;
    unpack(&l, change + 3 * start, gradients + 2 * start, bias, n);
    refused += count_refused(&l, highest, n);
    decide_untouched(&l, &s, hidden, given, start, n);
    write_back(&l, gradients + 2 * start, untouched + start, n);
  }
  return refused;
}
