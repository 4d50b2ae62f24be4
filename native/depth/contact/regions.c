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

enum { UNKNOWN = 2 };                     // bit of a pixel, beside 1 of a region's
enum { PIXELS, UNSEEN, OF_X, OF_Y, SUMS };  // over a region: pixels, unknown ones, x and y

// Regions of contact (h, w) with the unknown pixels that join it, or of such alone: their sums, of those of `least` pixels that have
// one of contact or deeper than `factor` deviations. Unknown are pixels neither known, at rest nor hidden; if they are under
// `least_unknown` in all, nothing is summed. `hidden`, `sigma`: NULL where there are none. Returns how many regions.
EXPORT int touched_regions(const bool *contact, const bool *known, const bool *at_rest, const bool *hidden, const float *depth,
                           const float *sigma, double *sums, int32_t *work, float factor, float least, float least_unknown,
                           ptrdiff_t h, ptrdiff_t w, ptrdiff_t m, ptrdiff_t n) {
  const ptrdiff_t words = runs_work(h, w), size = h * w;
  struct run *runs = (struct run *)work;
  uint8_t *map = (uint8_t *)(work + words);
  ptrdiff_t unknown = 0, regions = 0;
  if (n < words + (size + 3) / 4) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < size; i++) map[i] = !(known[i] | at_rest[i]);
  for (ptrdiff_t i = 0; hidden != NULL && i < size; i++) map[i] &= !hidden[i];
  for (ptrdiff_t i = 0; i < size; i++) unknown += map[i];
  if (unknown == 0 || (float)unknown < least_unknown) return 0;
  for (ptrdiff_t i = 0; i < size; i++) map[i] = (uint8_t)(UNKNOWN * map[i] | map[i] | contact[i]);
  const int32_t count = find_runs(map, 1, CORNERS, runs, h, w);
  for (int32_t k = 0; k < count; k++) {
    const int32_t first = first_of(runs, k);
    if (first != k) runs[first].area += runs[k].area;
  }
  for (int32_t k = 0; k < count; k++) {
    if (runs[k].parent != k) continue;
    const bool large = (float)runs[k].area >= least;
    if (large && regions == m) return WRONG_SIZE;
    if (large) memset(sums + SUMS * regions, 0, SUMS * sizeof *sums), sums[SUMS * regions] = -runs[k].area;  // not pressed so far
    runs[k].area = large ? (int32_t)regions++ : -1;
  }
  for (int32_t k = 0; k < count; k++) {
    const int32_t region = runs[first_of(runs, k)].area;
    if (region < 0) continue;
    double *sum = sums + SUMS * region;
    for (ptrdiff_t x = runs[k].from; x < runs[k].to; x++) {
      const ptrdiff_t i = runs[k].y * w + x;
      sum[UNSEEN] += map[i] >> 1, sum[OF_X] += (double)x, sum[OF_Y] += runs[k].y;
      if (contact[i] || depth[i] > (sigma == NULL ? 0 : factor * sigma[i])) sum[PIXELS] = fabs(sum[PIXELS]);
    }
  }
  ptrdiff_t pressed = 0;
  for (ptrdiff_t k = 0; k < regions; k++)
    if (sums[SUMS * k] > 0) memmove(sums + SUMS * pressed++, sums + SUMS * k, SUMS * sizeof *sums);
  memset(sums + SUMS * pressed, 0, (size_t)(SUMS * (regions - pressed)) * sizeof *sums);
  return (int)pressed;
}
