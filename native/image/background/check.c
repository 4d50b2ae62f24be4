// How far an image is like the untouched one, where it changed least.
#include "../../select.h"

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
