// The steps from a depth to its contacts, in their order; each is described where it is defined.
#ifndef GELFORM_CONTACT_STEPS_H
#define GELFORM_CONTACT_STEPS_H
#include "runs.h"

EXPORT int slope_variance(const float *read, const float *solved, const bool *at_rest, float *variance, ptrdiff_t count);
EXPORT int bent_surface(const float *depth, const float *taps, float *smooth, float *bent, float *work, float along_x, float along_y,
                        int64_t margin, ptrdiff_t h, ptrdiff_t w, ptrdiff_t t, ptrdiff_t n);
EXPORT int pressure_means(const float *smooth, const float *bent, const float *sigma, const float *slopes, const bool *known,
                          float *pressure, float *mean, float *spread, float *variance, float *mean_bent, float *work,
                          float stiffness, float sigmas, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n);
EXPORT int magnitude_of_share(const float *values, const float *units, const bool *chosen, float *work, float *magnitude,
                              int64_t step, double share, ptrdiff_t count, ptrdiff_t n);
EXPORT int sure_pressure(const float *pressure, const float *mean, const float *spread, const float *sigma, const float *slopes,
                         const float *noise, const bool *at_rest, const bool *known, float *sure, float *evidence, float stiffness,
                         float factor, float mean_gain_at_rest, float mean_gain_elsewhere, float gain_at_rest, float gain_elsewhere,
                         ptrdiff_t count);
EXPORT int contact_outline(const float *pressure, bool *contact, float *work, float share, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n);
EXPORT int held_outline(const bool *outline, const bool *closed, const bool *known, const float *mean, const float *smooth,
                        const float *bent, bool *contact, int32_t *work, float stiffness, float share, float reach, ptrdiff_t h,
                        ptrdiff_t w, ptrdiff_t n);
EXPORT int label_regions(const bool *mask, uint16_t *labels, int32_t *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n);
EXPORT int root_at_pixels(const float *variance, const bool *lost, float *work, float *sigma, float most, ptrdiff_t r, ptrdiff_t c,
                          ptrdiff_t h, ptrdiff_t w, ptrdiff_t n);
EXPORT int pressed_regions(const float *depth, const float *sigma, const float *noise, const float *read, const float *solved,
                           const bool *at_rest, const bool *known, const float *taps, const double *gains, float *smooth, float *bent,
                           float *evidence, uint16_t *labels, float *work, float along_x, float along_y, float stiffness, float factor,
                           float reach, int64_t margin, int64_t step, ptrdiff_t h, ptrdiff_t w, ptrdiff_t t, ptrdiff_t n);
EXPORT int variance_below(const float *depth, const float *sigma, double *excess, int64_t step, ptrdiff_t count);

#endif
