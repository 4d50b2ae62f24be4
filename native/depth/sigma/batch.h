// Right sides that share their couplings, solved together: what belongs to a right side has BATCH of them side by side,
// so that every coupling is read once for all, and small coarse levels fill a vector as well as large ones do.
#ifndef GELFORM_BATCH_H
#define GELFORM_BATCH_H

#include "../solvers/multigrid/grid.h"

enum { BATCH = LANES };  // one lane for each right side

// One level, as `struct level` has it: pixel (i, j), counted from 1, at `[i * stride + j]`, between zeros.
struct batch_level {
  ptrdiff_t height, width, stride;
  lanes *right, *guess, *answer;
};

struct batch {
  struct batch_level levels[MAX_LEVELS];
  int count;
  float *memory;
};

static inline lanes *lanes_at(lanes *plane, const struct batch_level *l, ptrdiff_t i, ptrdiff_t j) {
  return plane + i * l->stride + j;
}

bool batch_fits(const struct batch *b, const struct multigrid *m);
void batch_cycle(struct batch *b, const struct multigrid *m);

#endif
