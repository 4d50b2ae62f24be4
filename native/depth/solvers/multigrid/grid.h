// A frame and its coarser levels: couplings between pixels, and the work arrays of a solution.
//
// A plane of a level holds its pixel (i, j), counted from 1, at `plane[i * stride + j]`, between zeros: one row and
// column before, two rows and at least three columns after. So no loop asks where the border is. The coarse pixel (I, J)
// is the fine pixel (2I - 1, 2J - 1).
//
// The finest level has an odd height and width, so that coarse pixels lie on every border of the frame: what happens along a
// border without them is unknown to all coarser levels. A frame of even width gets one column more, before its last: each
// edge across it is cut into two of twice the coupling, which changes nothing in the frame's own pixels. Likewise rows.
#ifndef GELFORM_GRID_H
#define GELFORM_GRID_H

#include "../../../common.h"

enum { MAX_LEVELS = 24, COARSEST = 40, MAX_ISLANDS = 512, MAX_ISLAND_PIXELS = 8192 };

// Fractions of the coarse pixels in a fine pixel between them. LEFT and RIGHT belong to the fine pixel right of
// (I, J), UP and DOWN to the one below it, the last four to the one in the middle of four.
enum { LEFT, RIGHT, UP, DOWN, FROM_NW, FROM_NE, FROM_SW, FROM_SE, WEIGHTS };

struct level {
  ptrdiff_t height, width, stride;
  // Couplings, the operator's positive off-diagonals: (i, j) to (i, j + 1), (i + 1, j), (i + 1, j + 1), (i + 1, j - 1).
  // The finest level has no diagonal ones.
  float *east, *south, *southeast, *southwest;
  float *anchor, *inverse;  // the diagonal's own part, and 1 over the whole diagonal
  float *right, *answer;    // right side; what the cycle answers to it
  float *weights[WEIGHTS];  // interpolation from this level to the next finer one
};

// Small islands of pixels that hold together and hardly to their surroundings: see islands.c.
struct islands {
  int count, pixels;
  int next, next_residual;     // the first pixel that the current pass over the rows has not come to
  float tie[MAX_ISLANDS];      // what ties an island to its surroundings and to its anchors
  float shift[MAX_ISLANDS];    // how far the current cycle moves it
  float residual[MAX_ISLANDS];
  struct island_pixel {
    int32_t row, column, island;
    float share;  // how far it goes where the island moves by 1
  } pixel[MAX_ISLAND_PIXELS];  // from the top row to the bottom row
};

struct multigrid {
  ptrdiff_t height, width;           // of the frame
  struct level levels[MAX_LEVELS];
  int count;
  bool built;                        // the coarse levels are those of the finest
  float largest;                     // of the right side, absolute
  struct islands islands;
  float *depth, *search, *product;   // of the finest level: solution, search direction, operator times direction
  float *lines;                      // scratch: CYCLE_LINES of the length `line`, COARSEN_LINES of `coarse_line`
  ptrdiff_t line, coarse_line;
  double *elimination;               // scratch, COARSEST rows of twice as many
  float *dense;                      // inverse of the coarsest level's operator
  float *memory;
};

enum { CYCLE_LINES = 8, COARSEN_LINES = 40 };

static inline float *row(float *plane, const struct level *l, ptrdiff_t i) { return plane + i * l->stride; }
// Place of row or column `k` of a frame of n, counted from 1, on the finest level.
static inline ptrdiff_t on_finest(ptrdiff_t k, ptrdiff_t n) { return k == n ? n + 1 - n % 2 : k; }
static inline const struct level *coarsest(const struct multigrid *m) { return &m->levels[m->count - 1]; }

void coarsen(const struct multigrid *m, int level);
void invert_coarsest(const struct multigrid *m);
double solve_coarsest(const struct multigrid *m);

// A step of conjugate gradients that is still to be taken: along the search direction, from where the depth is.
struct step {
  bool pending, first;
  float length;
};

// The cycle's answer: its product with the right side, and its range.
struct answer {
  double product;
  float low, high;
};

struct answer cycle(struct multigrid *m, struct step step);

void find_islands(struct multigrid *m);
void shift_before(struct multigrid *m, struct step step);
void shift_between(struct multigrid *m);
void shift_after(struct multigrid *m, struct answer *answer);
void add_shifts(struct islands *islands, ptrdiff_t row, float *guess);
void subtract_shifts(struct multigrid *m, ptrdiff_t row, float *residual);
void add_residuals(struct multigrid *m, ptrdiff_t row, const float *guess, const float *tied);

#endif
