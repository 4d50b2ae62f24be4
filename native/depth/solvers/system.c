#include "../../common.h"

// Weights as shares of the largest inside the mask, `floor` at least, and which of them are more than that; 0 and untrusted
// outside. Found: the largest weight; how many pixels inside are not trusted. An anchor makes a pixel known, too.
EXPORT int scale_weights(const float *weights, const bool *mask, const float *anchor, float floor, float *confidence, bool *trusted,
                         bool *known, double *found, ptrdiff_t h, ptrdiff_t w) {
  float largest = 0;
  int32_t untrusted = 0;
  for (ptrdiff_t i = 0; i < h * w; i += w) {
    float *restrict row = confidence + i;
    memcpy(row, weights + i, w * sizeof *row);
    for (ptrdiff_t j = 0; mask && j < w; j++) row[j] = mask[i + j] ? row[j] : 0;
    largest = larger(largest_magnitude(row, w), largest);
  }
  for (ptrdiff_t i = 0; i < h * w && largest > 0; i += w) {
    float *restrict row = confidence + i;
    bool *restrict enough = trusted + i;
    int32_t count = 0;
    for (ptrdiff_t j = 0; j < w; j++) {
      const float share = row[j] / largest;
      enough[j] = share >= floor;
      count += share < floor;
      row[j] = larger(share, floor);
    }
    for (ptrdiff_t j = 0; mask && j < w; j++) {
      count -= !mask[i + j];
      row[j] = mask[i + j] ? row[j] : 0;
    }
    untrusted += count;
    for (ptrdiff_t j = 0; anchor && j < w; j++) known[i + j] = enough[j] | (anchor[i + j] > 0);
    if (anchor == NULL) memcpy(known + i, enough, (size_t)w * sizeof *known);
  }
  found[0] = largest, found[1] = untrusted;
  return OK;
}
