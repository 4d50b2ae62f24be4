// The steps by which faults of a frame are looked for, in their order; each is described where it is defined.
#ifndef GELFORM_HEALTH_STEPS_H
#define GELFORM_HEALTH_STEPS_H
#include "../../common.h"

EXPORT int health_blocks(const uint8_t *image, uint8_t *means, uint8_t *ranges, int64_t *digests, uint16_t *sums, ptrdiff_t h,
                         ptrdiff_t w, ptrdiff_t bh, ptrdiff_t bw);
EXPORT int health_signs(const uint8_t *means, const uint8_t *ranges, const int64_t *digests, const uint8_t *dark_to,
                        const uint8_t *saturated_from, int32_t *work, int32_t *signs, int32_t flat, ptrdiff_t bh, ptrdiff_t bw, ptrdiff_t h,
                        ptrdiff_t n);
EXPORT int health_seam(const uint16_t *sums, const uint16_t *rest, float *work, float *totals, float least, float factor,
                       float spill, ptrdiff_t h, ptrdiff_t n, ptrdiff_t m);
EXPORT int health_bands(const uint16_t *sums, const float *gray, const float *smooth, float *flat, float *common, ptrdiff_t h,
                        ptrdiff_t n);

#endif
