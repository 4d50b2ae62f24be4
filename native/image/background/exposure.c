// The densest place of log ratios of brightness, in three channels at once.
#include "../../select.h"

enum { BINS = 240, WINDOW = 6 };
static const double SPAN = 1.2;  // logs are sought within +-SPAN

// Middle of the window of bins that holds the most values of a channel.
static double fullest(const float *logs, ptrdiff_t n) {
  ptrdiff_t bins[BINS] = {0}, held = 0, most, first = 0;
  for (ptrdiff_t k = 0; k < n; k++) {
    const double bin = (logs[3 * k] + SPAN) * BINS / (2 * SPAN);
    bins[bin < 0 ? 0 : bin > BINS - 1 ? BINS - 1 : (ptrdiff_t)bin]++;
  }
  for (int k = 0; k < WINDOW; k++) held += bins[k];
  most = held;
  for (int k = 1; k <= BINS - WINDOW; k++) {
    held += bins[k + WINDOW - 1] - bins[k - 1];
    if (held > most) most = held, first = k;
  }
  return (first + WINDOW / 2.0) * 2 * SPAN / BINS - SPAN;
}

// Each value's distance from the center, of its largest channel; how many are near, and the sum of those.
static ptrdiff_t nearby(const float *logs, const double center[3], double half_width, double sums[3],
                        double *restrict distances, ptrdiff_t n) {
  ptrdiff_t inside = 0;
  sums[0] = sums[1] = sums[2] = 0;
  for (ptrdiff_t k = 0; k < n; k++) {
    const double a = logs[3 * k] - center[0], b = logs[3 * k + 1] - center[1], c = logs[3 * k + 2] - center[2];
    const double ab = fabs(a) > fabs(b) ? fabs(a) : fabs(b);
    distances[k] = ab > fabs(c) ? ab : fabs(c);
    if (distances[k] >= half_width) continue;
    inside++;
    sums[0] += a, sums[1] += b, sums[2] += c;
  }
  return inside;
}

// Returns how many log ratios (n, 3) are within the last half width of the center: each channel's fullest window first,
// then round by round the mean of the values that are near in all channels.
EXPORT int crowd_of_ratios(const float *logs, const double *half_widths, double *center, double *distances,
                           ptrdiff_t n, ptrdiff_t rounds) {
  ptrdiff_t inside = 0;
  for (int c = 0; c < 3; c++) center[c] = fullest(logs + c, n);
  for (ptrdiff_t round = 0; round < rounds; round++) {
    double sums[3];
    inside = nearby(logs, center, half_widths[round], sums, distances, n);
    if (inside == 0) break;
    for (int c = 0; c < 3; c++) center[c] += sums[c] / inside;
  }
  return (int)inside;
}

// Ratios of blocks (n, 3) to untouched ones, of those that are neither dark nor saturated in any channel; returns how many.
EXPORT int lit_ratios(const float *blocks, const float *untouched, float dark, float bright, float *ratios, ptrdiff_t n,
                      ptrdiff_t most) {
  int count = 0;
  if (most <= n) return WRONG_SIZE;  // one row is written behind the last that counts
  for (ptrdiff_t k = 0; k < n; k++) {
    bool lit = true;
    for (int c = 0; c < 3; c++) {
      const float a = blocks[3 * k + c], b = untouched[3 * k + c];
      lit = lit && smaller(a, b) > dark && larger(a, b) < bright;
      ratios[3 * count + c] = a / b;
    }
    count += lit;
  }
  return count;
}

// Sums over both sets of blocks of (a - mean)^2, (b - mean)^2, (a - mean) (b - mean), with a: seen, scaled; b: untouched. Only
// the blocks that changed least take part: `last` of them are nearer to the untouched ones than the last that does.
EXPORT int least_changed_sums(const float *seen, const float *untouched, const float *scale, int64_t last, float *work,
                              double *sums, ptrdiff_t n, ptrdiff_t m) {
  if (last < 0 || last >= n || m < 2 * n) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < n; k++) {
    work[k] = 0;
    for (int c = 0; c < 3; c++) work[k] += fabsf(seen[3 * k + c] * scale[c] - untouched[3 * k + c]);
  }
  const float farthest = kth_smallest(work, n, last, (uint32_t *)(work + n));
  double mean_a = 0, mean_b = 0;
  ptrdiff_t count = 0;
  for (ptrdiff_t k = 0; k < n; k++) {
    if (work[k] > farthest) continue;
    for (int c = 0; c < 3; c++) mean_a += seen[3 * k + c] * scale[c], mean_b += untouched[3 * k + c];
    count += 3;
  }
  mean_a /= count, mean_b /= count;
  sums[0] = sums[1] = sums[2] = 0;
  for (ptrdiff_t k = 0; k < n; k++) {
    if (work[k] > farthest) continue;
    for (int c = 0; c < 3; c++) {
      const double a = seen[3 * k + c] * scale[c] - mean_a, b = untouched[3 * k + c] - mean_b;
      sums[0] += a * a, sums[1] += b * b, sums[2] += a * b;
    }
  }
  return (int)count;
}

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
