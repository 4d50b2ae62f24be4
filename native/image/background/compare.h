// The steps by which an image's blocks are compared with the untouched ones, in their order; each is described where it is defined.
#ifndef GELFORM_COMPARE_H
#define GELFORM_COMPARE_H
#include "../../select.h"

EXPORT int means_of_bytes(const uint8_t *image, int64_t step, uint16_t *work, float *means, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n,
                          ptrdiff_t bh, ptrdiff_t bw);
EXPORT int lit_blocks(const float *blocks, const float *untouched, int64_t step, float dark, float bright, float *lit,
                      float *medians, float *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n, ptrdiff_t m);
EXPORT int least_changed_correlation(const float *seen, const float *untouched, const float *scale, float *work, double *correlation,
                                     ptrdiff_t n, ptrdiff_t m);

#endif
