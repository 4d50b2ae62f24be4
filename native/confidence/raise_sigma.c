// What raises the standard deviation of a frame's slopes beyond the law: one pass, and the confidence that follows.
#include "../common.h"

enum { ROWS = 8, COLUMNS = 16, TERMS = 9 };  // a cell of the forward response, and the monomials of two slopes

struct causes {
  const float *cells, *bias;
  float unexplained, per_change, unseen, clean, added;
  uint8_t dark_to, saturated_from;
};

// RMS of the channels of the color change minus that which the slopes explain.
static inline void find_unexplained(const float *restrict cell, const float *restrict change,
                                    const float *restrict gradients, const float *restrict bias, float *restrict unexplained,
                                    int n) {
  for (int k = 0; k < n; k++) {
    const float p = gradients[2 * k] + bias[0], q = gradients[2 * k + 1] + bias[1];
    const float pp = p * p, pq = p * q, qq = q * q;
    const float of[TERMS] = {p, q, pp, pq, qq, pp * p, pp * q, p * qq, qq * q};
    float r = change[3 * k], g = change[3 * k + 1], b = change[3 * k + 2];
    for (int t = 0; t < TERMS; t++) r -= of[t] * cell[3 * t], g -= of[t] * cell[3 * t + 1], b -= of[t] * cell[3 * t + 2];
    unexplained[k] = sqrtf((r * r + g * g + b * b) * (1.0f / 3));
  }
}

static inline void add_unexplained(const struct causes *c, const float *restrict unexplained, float *restrict variance,
                                   int n) {
  for (int k = 0; k < n; k++) {
    const float sigma = c->per_change * larger(unexplained[k] - c->unexplained, 0);
    variance[k] += sigma * sigma;
  }
}

// How many pixels have a channel at an end of the range; only these are marked in `clipped`.
static inline int find_clipped(const struct causes *c, const uint8_t *restrict image, bool *restrict clipped, int n) {
  int count = 0;
  for (int k = 0; k < n; k++) {
    const uint8_t r = image[3 * k], g = image[3 * k + 1], b = image[3 * k + 2];
    const uint8_t low = r < g ? (r < b ? r : b) : (g < b ? g : b), high = r > g ? (r > b ? r : b) : (g > b ? g : b);
    clipped[k] = (low <= c->dark_to) | (high >= c->saturated_from);
    count += clipped[k];
  }
  return count;
}

static inline void finish(const struct causes *c, const float *restrict variance, const float *restrict gain,
                          float *restrict sigma, float *restrict confidence, int n) {
  for (int k = 0; k < n; k++) {
    const float noise = c->added * gain[k], total = sigma[k] * sigma[k] + variance[k] + noise * noise;
    sigma[k] = sqrtf(total);
    confidence[k] = smaller(c->clean * c->clean / total, 1);
  }
}

// Pixels at the camera's ends are marked in `clipped`, not counted in sigma: how far they reach is known afterwards.
EXPORT int raise_sigma(const uint8_t *image, const float *change, const float *gradients, const bool *unseen_at,
                       const float *cells, const float *bias, const float *gain, float *sigma, float *confidence,
                       bool *clipped, float unexplained, float per_change, float unseen, float clean, float added,
                       int32_t dark_to, int32_t saturated_from, ptrdiff_t h, ptrdiff_t w, ptrdiff_t ch, ptrdiff_t cw) {
  const struct causes c = {cells, bias, unexplained, per_change, unseen, clean, added, (uint8_t)dark_to, (uint8_t)saturated_from};
  const float square = unseen * unseen;
  int count = 0;
  if (cells != NULL && (ch != (h + ROWS - 1) / ROWS || cw != (w + COLUMNS - 1) / COLUMNS)) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x += COLUMNS) {
      const ptrdiff_t at = y * w + x;
      const int n = w - x < COLUMNS ? (int)(w - x) : COLUMNS;
      float unexplained_by[COLUMNS], variance[COLUMNS] = {0};
      if (cells != NULL) {
        find_unexplained(cells + (y / ROWS * cw + x / COLUMNS) * TERMS * 3, change + 3 * at, gradients + 2 * at, bias,
                         unexplained_by, n);
        add_unexplained(&c, unexplained_by, variance, n);
      }
      if (unseen_at != NULL)
        for (int k = 0; k < n; k++) variance[k] += unseen_at[at + k] ? square : 0;
      count += find_clipped(&c, image + 3 * at, clipped + at, n);
      finish(&c, variance, gain + at, sigma + at, confidence + at, n);
    }
  return count;
}
