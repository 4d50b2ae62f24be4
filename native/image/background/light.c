// A light, exp(L(x, y)) B + r, fitted to blocks of an image by Gauss-Newton, with touched blocks as outliers; then the likeness in it.
#include "../../select.h"

enum { CHANNELS = 3, TERMS = 4 };  // a channel's gain, its tilts along x and y, its room light

// Means over blocks of `step` x `step` pixels, in whole gray levels, half to even, as a camera's image would have them.
EXPORT int means_of_bytes(const uint8_t *image, int64_t step, uint16_t *work, float *means, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n,
                          ptrdiff_t bh, ptrdiff_t bw) {
  if (step < 1 || step > 256 || bh * step != h || bw * step != w || n != 3 * w) return WRONG_SIZE;
  const float share = 1.0f / (float)(step * step);
  for (ptrdiff_t i = 0; i < bh; i++) {
    memset(work, 0, (size_t)n * sizeof *work);
    for (ptrdiff_t y = i * step; y < (i + 1) * step; y++) {
      const uint8_t *restrict row = image + 3 * w * y;
      for (ptrdiff_t x = 0; x < n; x++) work[x] += row[x];
    }
    for (ptrdiff_t j = 0; j < bw; j++)
      for (int c = 0; c < 3; c++) {
        int32_t total = 0;
        for (ptrdiff_t x = j * step; x < (j + 1) * step; x++) total += work[3 * x + c];
        means[3 * (i * bw + j) + c] = rintf((float)total * share);
      }
  }
  return OK;
}

// Of the middle of a block, from -1 to 1 between the borders.
static float place(ptrdiff_t k, ptrdiff_t n) { return (float)(2 * k + 1) / (float)n - 1; }

// Blocks of every `step`-th row and column that are neither dark nor saturated in any channel. `lit` receives their red, green and
// blue, those of the untouched ones, and their places along x and y; `medians` the median ratio of each channel. Returns how many.
EXPORT int lit_blocks(const float *blocks, const float *untouched, int64_t step, float dark, float bright, float *lit,
                      float *medians, float *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n, ptrdiff_t m) {
  ptrdiff_t count = 0;
  if (step < 1 || n <= sampled(h, w, step) || m < 2 * n) return WRONG_SIZE;
  for (ptrdiff_t y = 0; y < h; y += step)
    for (ptrdiff_t x = 0; x < w; x += step) {  // what a block leaves is overwritten unless it is lit
      const float *image = blocks + 3 * (y * w + x), *rest = untouched + 3 * (y * w + x);
      bool is_lit = true;
      for (int c = 0; c < CHANNELS; c++) {
        is_lit = is_lit && smaller(image[c], rest[c]) > dark && larger(image[c], rest[c]) < bright;
        lit[c * n + count] = image[c], lit[(CHANNELS + c) * n + count] = rest[c];
      }
      lit[2 * CHANNELS * n + count] = place(x, w), lit[(2 * CHANNELS + 1) * n + count] = place(y, h);
      count += is_lit;
    }
  for (int c = 0; c < CHANNELS; c++) {
    for (ptrdiff_t k = 0; k < count; k++) work[k] = lit[c * n + k] / lit[(CHANNELS + c) * n + k];
    medians[c] = count > 0 ? median(work, count, (uint32_t *)(work + n)) : 1;
  }
  return (int)count;
}

// The natural logarithm of x > 0 to 1e-15: x = 2^e m with m within a root of 2 of 1, and the series of atanh. The C library's
// has other bits on other processors.
static double logarithm_of(double x) {
  uint64_t bits;
  memcpy(&bits, &x, sizeof bits);
  int32_t exponent = (int32_t)(bits >> 52 & 0x7ff) - 1022;
  bits = (bits & 0x000fffffffffffffu) | 0x3fe0000000000000u;
  double m;
  memcpy(&m, &bits, sizeof m);
  if (m < 0.70710678118654752) m *= 2, exponent--;
  const double s = (m - 1) / (m + 1), square = s * s;
  double series = 0;
  for (int k = 21; k >= 1; k -= 2) series = series * square + 1.0 / k;
  return 2 * s * series + exponent * 0.69314718055994531;
}

// The same bits on every platform; a value below e^-80 counts as that.
static inline float exponential(float z) {
  const float limited = clamp(z, -80.0f, 80.0f), nearest = limited * 1.44269504f + (limited < 0 ? -0.5f : 0.5f);
  const int32_t doublings = (int32_t)nearest;
  const float x = (limited - (float)doublings * 0.693145752f) - (float)doublings * 1.42860677e-6f;
  const uint32_t bits = (uint32_t)(doublings + 127) << 23;
  float scale;
  memcpy(&scale, &bits, sizeof scale);
  const float high = 1 / 6.0f + x * (1 / 24.0f + x * (1 / 120.0f + x * (1 / 720.0f)));
  return scale * (1 + x * (1 + x * (0.5f + x * high)));
}

struct lit_blocks {
  const float *image, *untouched, *across, *down;  // (3, n), (3, n), (n,), (n,)
  float *residual, *per_log, *per_level;           // work: (3, n) each
  float *terms, *weighted;                         // (2, n), (n,)
  float *square, *farthest, *at_rest;              // (n,): squared residual, largest change of a channel, share at rest
  float offset;                                    // gray levels
  ptrdiff_t n, count;
};

// What a light leaves: the normal matrices and right sides of the next step, unscaled.
struct fit_sums {
  double normal[CHANNELS][TERMS][TERMS], side[CHANNELS][TERMS], at_rest, squares;
};

// Relative residuals of a channel, and their derivatives by the logarithm of the light and by its gray levels.
static void leave(const struct lit_blocks *b, int c, const double values[TERMS]) {
  const float gain = (float)values[0], tilt_x = (float)values[1], tilt_y = (float)values[2], room = (float)values[3];
  const float *restrict image = b->image + c * b->n, *restrict untouched = b->untouched + c * b->n;
  const float *restrict across = b->across, *restrict down = b->down, offset = b->offset;
  float *restrict residual = b->residual + c * b->n, *restrict per_log = b->per_log + c * b->n;
  float *restrict per_level = b->per_level + c * b->n, *restrict square = b->square, *restrict farthest = b->farthest;
  INDEPENDENT
  for (ptrdiff_t k = 0; k < b->count; k++) {
    const float light = exponential(gain + across[k] * tilt_x + down[k] * tilt_y) * untouched[k];
    per_level[k] = 1 / larger(light + room + offset, 1.0f);
    per_log[k] = light * per_level[k];
    residual[k] = (image[k] + offset) * per_level[k] - 1;
    const float own = residual[k] * residual[k], size = fabsf(image[k] / larger(light + room, 1.0f) - 1);
    square[k] = c == 0 ? own : square[k] + own;
    farthest[k] = c == 0 ? size : larger(farthest[k], size);
  }
}

static struct fit_sums sums_of(const struct lit_blocks *b, const double values[CHANNELS][TERMS], const bool *wanted, double sigma,
                               double wide) {
  const double ratio = sigma / wide;
  const float odds = (float)(ratio * ratio * ratio), apart = (float)(0.5 / (sigma * sigma) - 0.5 / (wide * wide));
  float *restrict at_rest = b->at_rest, *restrict weighted = b->weighted;
  const float *restrict square = b->square;
  struct fit_sums sums = {0};
  for (int c = 0; c < CHANNELS; c++) leave(b, c, values[c]);
  INDEPENDENT
  for (ptrdiff_t k = 0; k < b->count; k++) {
    const float odd = exponential(-square[k] * apart);
    at_rest[k] = odd / (odd + odds);
  }
  sums.at_rest = sum(at_rest, b->count), sums.squares = dot(at_rest, square, b->count);
  for (int c = 0; c < CHANNELS; c++) {
    const float *per_log = b->per_log + c * b->n, *per_level = b->per_level + c * b->n;
    const float *factors[TERMS] = {NULL, b->across, b->down, NULL}, *terms[TERMS] = {per_log, b->terms, b->terms + b->n, per_level};
    for (int i = 1; i < 3; i++) {
      float *restrict term = b->terms + (i - 1) * b->n;
      for (ptrdiff_t k = 0; k < b->count && wanted[i]; k++) term[k] = per_log[k] * factors[i][k];
    }
    for (int i = 0; i < TERMS; i++) {
      if (!wanted[i]) continue;
      const float *restrict term = terms[i];
      for (ptrdiff_t k = 0; k < b->count; k++) weighted[k] = at_rest[k] * term[k];
      sums.side[c][i] = dot(weighted, b->residual + c * b->n, b->count);
      for (int j = 0; j <= i; j++) sums.normal[c][i][j] = wanted[j] ? dot(weighted, terms[j], b->count) : 0;
    }
  }
  return sums;
}

// Solves for one channel's step by Cholesky's factors; the prior makes the matrix positive definite. Terms that are not free stay.
// Returns the logarithm of the determinant.
static double solve(const double a[TERMS][TERMS], const double side[TERMS], const bool *is_free, double step[TERMS]) {
  double factor[TERMS][TERMS], logarithm = 0;
  for (int i = 0; i < TERMS; i++)
    for (int j = 0; j <= i; j++) {
      double left = is_free[i] && is_free[j] ? a[i][j] : i == j;
      for (int k = 0; k < j; k++) left -= factor[i][k] * factor[j][k];
      factor[i][j] = i == j ? sqrt(left) : left / factor[j][j];
    }
  for (int i = 0; i < TERMS; i++) {
    step[i] = is_free[i] ? side[i] : 0;
    for (int k = 0; k < i; k++) step[i] -= factor[i][k] * step[k];
    step[i] /= factor[i][i];
    logarithm += 2 * logarithm_of(factor[i][i]);
  }
  for (int i = TERMS - 1; i >= 0; i--) {
    for (int k = i + 1; k < TERMS; k++) step[i] -= factor[k][i] * step[k];
    step[i] /= factor[i][i];
  }
  return logarithm;
}

// Mean logarithm of the likelihood of blocks that are at rest or touched, each half of all.
static double log_likelihood(const struct lit_blocks *b, double sigma, double wide) {
  const double ratio = sigma / wide, odds = ratio * ratio * ratio, apart = 0.5 / (sigma * sigma) - 0.5 / (wide * wide);
  double total = -3 * logarithm_of(sigma) * b->count, product = 1;
  for (ptrdiff_t k = 0; k < b->count; k++) {
    total -= b->square[k] / (2 * wide * wide);
    product *= exponential((float)(-b->square[k] * apart)) + odds;
    if (product < 1e-200) total += logarithm_of(product), product = 1;
  }
  return (total + logarithm_of(product)) / (b->count > 0 ? b->count : 1);
}

// `values` (3, 4), the light to begin with, are moved by a step in every round but the last; terms that are not `is_free` stay.
// `prior` holds each term's inverse variance; `alike` is the number of independent blocks; `widened` the deviation at rest in each
// round, in units of `sigma`, or of the last round's, from `least` to `most`, unless `most` is 0. Of the last round come: `normal`, the inverse covariance of all
// terms; of each block the `square` of the residual and the `farthest` channel's change; and the `figures`: deviation at rest, blocks at
// rest, log likelihood, evidence, and the nats by which all terms promise to fit better than the free ones (a score test).
EXPORT int fit_light(const float *lit, int64_t count, const double *prior, const bool *is_free, const double *widened,
                     double *values, double *normal, float *farthest, double *figures, float *work, double sigma, double least,
                     double most, double wide, double alike, float offset, ptrdiff_t n, ptrdiff_t rounds, ptrdiff_t m) {
  static const bool all[TERMS] = {true, true, true, true};
  struct lit_blocks b = {lit, lit + CHANNELS * n, lit + 2 * CHANNELS * n, lit + (2 * CHANNELS + 1) * n, work, work + 3 * n,
                         work + 6 * n, work + 9 * n, work + 11 * n, work + 12 * n, farthest, work + 13 * n, offset, n, count};
  double(*light)[TERMS] = (double(*)[TERMS])values, (*matrices)[TERMS][TERMS] = (double(*)[TERMS][TERMS])normal;
  if (count < 0 || count > n || m < 14 * n) return WRONG_SIZE;
  for (ptrdiff_t round = 0; round < rounds; round++) {
    const bool is_last = round + 1 == rounds;
    const double deviation = sigma * widened[round];
    const struct fit_sums found = sums_of(&b, (const double(*)[TERMS])light, is_last ? all : is_free, deviation, wide);
    const double weight = alike / ((count > 0 ? count : 1) * deviation * deviation);
    const double learnt = sqrt(found.squares / (CHANNELS * found.at_rest + 1e-9));
    double evidence = is_last ? alike * log_likelihood(&b, deviation, wide) : 0, promised = 0;
    figures[1] = found.at_rest, figures[2] = evidence;
    for (int c = 0; c < CHANNELS; c++) {
      double side[TERMS], step[TERMS];
      for (int i = 0; i < TERMS; i++) {
        for (int j = 0; j <= i; j++)
          matrices[c][i][j] = matrices[c][j][i] = weight * found.normal[c][i][j] + (i == j ? prior[i] : 0);
        side[i] = weight * found.side[c][i] - prior[i] * light[c][i];
      }
      const double logarithm = solve((const double(*)[TERMS])matrices[c], side, is_free, step);
      for (int i = 0; i < TERMS; i++) {
        evidence -= is_free[i] ? prior[i] * light[c][i] * light[c][i] / 2 - logarithm_of(prior[i]) / 2 : 0;
        promised -= side[i] * step[i] / 2;
        if (!is_last) light[c][i] += step[i];
      }
      evidence -= logarithm / 2;
      if (!is_last) continue;
      solve((const double(*)[TERMS])matrices[c], side, all, step);
      for (int i = 0; i < TERMS; i++) promised += side[i] * step[i] / 2;
    }
    figures[3] = evidence, figures[4] = promised;
    if (most > 0) sigma = learnt > most ? most : learnt > least ? learnt : least;
    figures[0] = sigma;
  }
  return OK;
}

// Correlation over both sets of blocks, channels together, of seen, scaled, with untouched: over the half that changed least. NaN if
// the untouched blocks are featureless; 0 if only the seen ones are.
EXPORT int least_changed_correlation(const float *seen, const float *untouched, const float *scale, float *work, double *correlation,
                                     ptrdiff_t n, ptrdiff_t m) {
  if (n < 1 || m < 2 * n) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < n; k++) {
    work[k] = 0;
    for (int c = 0; c < 3; c++) work[k] += fabsf(seen[3 * k + c] * scale[c] - untouched[3 * k + c]);
  }
  const float farthest = kth_smallest(work, n, n / 2, (uint32_t *)(work + n));
  double mean_a = 0, mean_b = 0, count = 0, of_seen = 0, of_untouched = 0, of_both = 0;
  for (ptrdiff_t k = 0; k < n; k++) {
    if (work[k] > farthest) continue;
    for (int c = 0; c < 3; c++) mean_a += seen[3 * k + c] * scale[c], mean_b += untouched[3 * k + c];
    count += 3;
  }
  mean_a /= count, mean_b /= count;
  for (ptrdiff_t k = 0; k < n; k++) {
    if (work[k] > farthest) continue;
    for (int c = 0; c < 3; c++) {
      const double a = seen[3 * k + c] * scale[c] - mean_a, b = untouched[3 * k + c] - mean_b;
      of_seen += a * a, of_untouched += b * b, of_both += a * b;
    }
  }
  const double least = 1e-4 * count;
  *correlation = of_untouched < least ? NAN : of_seen < least ? 0 : of_both / sqrt(of_seen * of_untouched);
  return OK;
}

// The light as a gain alone, from the blocks' median ratio, in one call with what precedes and follows it. `image`: its means go to
// `blocks` first; NULL: they are given. `beside`: the change that a quarter and a half of the lit blocks exceed not, of the channel
// that changed most; the least inverse variance of a channel's gain; the correlation without the gain. Returns how many are lit.
EXPORT int gain_of_blocks(const uint8_t *image, float *blocks, const float *untouched, const double *prior, const bool *is_free,
                          const double *widened, float *lit, double *values, double *normal, float *farthest, double *figures,
                          double *beside, float *work, int64_t step, float dark, float bright, double sigma, double least, double most,
                          double wide, double alike, float offset, ptrdiff_t h, ptrdiff_t w, ptrdiff_t bh, ptrdiff_t bw,
                          ptrdiff_t rounds, ptrdiff_t n, ptrdiff_t m) {
  float medians[CHANNELS], scale[CHANNELS];
  if (bh < 1 || 2 * m < 3 * w) return WRONG_SIZE;
  if (image != NULL && means_of_bytes(image, h / bh, (uint16_t *)work, blocks, h, w, 3 * w, bh, bw) != OK) return WRONG_SIZE;
  const int count = lit_blocks(blocks, untouched, step, dark, bright, lit, medians, work, bh, bw, n, m);
  if (count < 0) return WRONG_SIZE;
  for (int i = 0; i < CHANNELS * TERMS; i++) values[i] = i % TERMS == 0 ? logarithm_of((double)medians[i / TERMS]) : 0;
  if (fit_light(lit, count, prior, is_free, widened, values, normal, farthest, figures, work, sigma, least, most, wide, alike, offset, n,
                rounds, m) != OK)
    return WRONG_SIZE;
  beside[2] = INFINITY;
  for (int k = 0; k < 2; k++) beside[k] = count > 0 ? (double)kth_smallest(farthest, count, count / (k == 0 ? 4 : 2), (uint32_t *)work) : NAN;
  for (int c = 0; c < CHANNELS; c++) {
    const double information = normal[c * TERMS * TERMS];
    beside[2] = information < beside[2] ? information : beside[2];
    scale[c] = exponential((float)-values[c * TERMS]);
  }
  return least_changed_correlation(blocks, untouched, scale, work, beside + 3, bh * bw, m) == OK ? count : WRONG_SIZE;
}
