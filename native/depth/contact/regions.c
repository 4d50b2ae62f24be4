// The regions of a mask.
#include "steps.h"

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
