// Connected regions of a map, of runs of pixels in its rows that are joined where they touch.
#ifndef GELFORM_RUNS_H
#define GELFORM_RUNS_H
#include "../../common.h"

// Pixels from ... to - 1 of row y. A run's parent is an earlier run of its region, or itself.
struct run {
  int32_t y, from, to, parent;
  union {
    int32_t area;
    float excess;
  };
};

enum { RUN_WORDS = sizeof(struct run) / sizeof(int32_t) };

// Words that the runs of a map may need.
static inline ptrdiff_t runs_work(ptrdiff_t h, ptrdiff_t w) { return h * ((w + 1) / 2) * RUN_WORDS; }

static inline int32_t first_of(struct run *runs, int32_t k) {
  while (runs[k].parent != k) k = runs[k].parent = runs[runs[k].parent].parent;
  return k;
}

static inline void join(struct run *runs, int32_t a, int32_t b) {
  a = first_of(runs, a), b = first_of(runs, b);
  if (a < b) runs[b].parent = a;
  else runs[a].parent = b;
}

// The first pixel from x on that has one of the bits, or w.
static inline ptrdiff_t next_set(const uint8_t *row, ptrdiff_t x, ptrdiff_t w, uint8_t bits) {
  const uint64_t eight = bits * 0x0101010101010101u;
  for (uint64_t word; x + 8 <= w; x += 8) {
    memcpy(&word, row + x, sizeof word);
    if (word & eight) break;
  }
  while (x < w && !(row[x] & bits)) x++;
  return x;
}

enum { EDGES = 0, CORNERS = 1 };  // what pixels have to share to touch: an edge, or a corner at least

// Runs of pixels that have one of the bits, from the first row to the last, joined into regions; how many runs.
static inline int32_t find_runs(const uint8_t *map, uint8_t bits, int touch, struct run *runs, ptrdiff_t h, ptrdiff_t w) {
  int32_t count = 0, above = 0;  // above: the first run of the row before that may touch what follows
  for (ptrdiff_t y = 0; y < h; y++) {
    const uint8_t *row = map + y * w;
    const int32_t before = count;
    for (ptrdiff_t x = next_set(row, 0, w, bits); x < w; x = next_set(row, x, w, bits)) {
      const ptrdiff_t from = x;
      while (x < w && row[x] & bits) x++;
      while (above < before && runs[above].to <= from - touch) above++;
      runs[count] = (struct run){(int32_t)y, (int32_t)from, (int32_t)x, count, (int32_t)(x - from)};
      for (int32_t k = above; k < before && runs[k].from < x + touch; k++) join(runs, k, count);
      count++;
    }
    above = before;
  }
  return count;
}

#endif
