// The regions of a mask: unknown ones that are added to it, and their labels.
#include "runs.h"

enum { PRESSED = 1, UNKNOWN = 2 };

static inline int32_t side_of(uint8_t pixel) { return pixel & UNKNOWN ? 0 : pixel & PRESSED ? 1 : -1; }

// How many more of the known pixels that a run touches are pressed than are not.
static int32_t pressed_around(const uint8_t *map, const struct run *run, ptrdiff_t h, ptrdiff_t w) {
  const uint8_t *row = map + run->y * w;
  int32_t more = run->from > 0 ? side_of(row[run->from - 1]) : 0;
  if (run->to < w) more += side_of(row[run->to]);
  for (ptrdiff_t x = run->from; x < run->to; x++) {
    if (run->y > 0) more += side_of(row[x - w]);
    if (run->y < h - 1) more += side_of(row[x + w]);
  }
  return more;
}

// Adds to the pressed pixels the regions of unknown ones, such as dots, whose border is pressed for the most part.
EXPORT int add_unknown(const bool *known, const bool *pressed, bool *contact, int32_t *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  struct run *runs = (struct run *)work;
  uint8_t *map = (uint8_t *)contact;
  if (n < runs_work(h, w)) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < h * w; i++) map[i] = (uint8_t)((known[i] & pressed[i]) | !known[i] << 1);  // PRESSED, UNKNOWN
  const int32_t count = find_runs(map, UNKNOWN, EDGES, runs, h, w);
  for (int32_t k = 0; k < count; k++) runs[k].area = 0;
  for (int32_t k = 0; k < count; k++) runs[first_of(runs, k)].area += pressed_around(map, runs + k, h, w);
  for (int32_t k = 0; k < count; k++)
    memset(map + runs[k].y * w + runs[k].from, runs[first_of(runs, k)].area > 0, (size_t)(runs[k].to - runs[k].from));
  return OK;
}

// Labels 1 ... of a mask's regions, in the order of their first pixels, and 0; how many. Where they are more than fit, nothing
// is written.
EXPORT int label_regions(const bool *mask, uint16_t *labels, int32_t *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  struct run *runs = (struct run *)work;
  int regions = 0;
  if (n < runs_work(h, w)) return WRONG_SIZE;
  const int32_t count = find_runs((const uint8_t *)mask, 1, CORNERS, runs, h, w);
  for (int32_t k = 0; k < count; k++) regions += runs[k].parent == k;
  if (regions > UINT16_MAX) return regions;
  memset(labels, 0, (size_t)(h * w) * sizeof *labels);
  regions = 0;
  for (int32_t k = 0; k < count; k++) {
    const int32_t first = first_of(runs, k);
    const int32_t label = first == k ? (runs[k].area = ++regions) : runs[first].area;
    for (ptrdiff_t x = runs[k].from; x < runs[k].to; x++) labels[runs[k].y * w + x] = (uint16_t)label;
  }
  return regions;
}
