// How far an image is like the untouched one, where it changed least.
#include "compare.h"

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
