// Slopes whose color no slope explains.
#include "../../common.h"

// Whether some value is at or over a limit; nothing else has to be computed.
static inline bool any_from(const float *restrict values, float limit, int n) {
  int count = 0;
  for (int k = 0; k < n; k++) count += values[k] >= limit;
  return count > 0;
}

// Variance of slopes whose color leaves a residual of more than half of `outlier`: from `outlier` on nothing is known of the
// slope, whose deviation is `unknown` then.
static inline void variance_of_outliers(float *restrict variance, const float *restrict residual, float outlier, float unknown, int n) {
  for (int k = 0; k < n; k++) variance[k] = 0;
  if (residual == NULL || !any_from(residual, 0.5f * outlier, n)) return;
  const float per_outlier = 2 / outlier;
  for (int k = 0; k < n; k++) {
    const float off = unknown * larger(residual[k] * per_outlier - 1, 0);
    variance[k] = off * off;
  }
}
