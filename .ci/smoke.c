// A weighted and a uniform problem of made-up slopes: prints a digest of both depths, to be compared between platforms.
#include <stdio.h>
#include <stdlib.h>

#include "../native/solvers/multigrid/grid.h"

enum { H = 96, W = 130 };

void *multigrid_new(ptrdiff_t, ptrdiff_t);
void multigrid_free(void *);
int multigrid_load(struct multigrid *, const float *, const float *, const float *, float, float, ptrdiff_t, ptrdiff_t);
int multigrid_build(struct multigrid *);
int multigrid_solve(struct multigrid *, const float *, float *, double, double, int32_t, double *, ptrdiff_t, ptrdiff_t);
int dct_right_side(const float *, float *, float, float, ptrdiff_t, ptrdiff_t, ptrdiff_t);

static uint32_t state = 1;

static float uniform(void) {
  state = state * 1664525u + 1013904223u;
  return (float)(state >> 8) / 16777216.0f;
}

static uint64_t digest(const float *values, ptrdiff_t n) {
  uint64_t hash = 1469598103934665603u;
  const unsigned char *bytes = (const unsigned char *)values;
  for (size_t k = 0; k < n * sizeof *values; k++) hash = (hash ^ bytes[k]) * 1099511628211u;
  return hash;
}

int main(void) {
  static float gradients[H * W * 2], confidence[H * W], anchor[H * W], depth[H * W], right[H * W];
  for (int k = 0; k < 2 * H * W; k++) gradients[k] = uniform() - 0.5f;
  for (int k = 0; k < H * W; k++) confidence[k] = uniform() < 0.1f ? 1e-3f : 1.0f, anchor[k] = uniform() < 0.5f ? 1e-2f : 0.0f;
  struct multigrid *grid = multigrid_new(H, W);
  double report[2];
  if (!grid) return 1;
  multigrid_load(grid, gradients, confidence, anchor, 0.06f, 0.07f, H, W);
  multigrid_build(grid);
  if (multigrid_solve(grid, NULL, depth, 0, 4e-4, 100, report, H, W)) return 2;
  multigrid_free(grid);
  dct_right_side(gradients, right, 0.03f, 0.04f, H, W, W);
  printf("%d iterations, depth %016llx, right side %016llx\n", (int)report[0], (unsigned long long)digest(depth, H * W),
         (unsigned long long)digest(right, H * W));
  return 0;
}
