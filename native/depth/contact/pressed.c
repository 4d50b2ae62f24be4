// depth -> the regions whose pressure exceeds its own uncertainty: all steps up to their labels, in one call.
#include "steps.h"

enum { CLOSED_TO = 2 };  // px, half the gap that is closed; half the gap beside a cube's crest

static const float SIGMAS = 2;        // only depth beyond so many deviations presses on the bed
static const float ENDS_AT = 2.0f / 3;  // a contact ends at this share of the mean pressure: three simulated and six real sensors
static const float HELD_FROM = 0.5f;  // share of the bed's pressure that holds gaps and holes: between the membrane and a plane face

// Each pixel with its neighbors along one axis, `step` pixels apart: `any` or all of them; nothing is outside of the frame.
static void gather(const uint8_t *restrict from, uint8_t *restrict to, ptrdiff_t n, ptrdiff_t step, bool any) {
  memcpy(to, from, (size_t)n);
  for (ptrdiff_t by = step; by <= CLOSED_TO * step && by < n; by += step) {
    uint8_t *restrict after = to + by;
    const uint8_t *restrict next = from + by;
    if (any) {
      for (ptrdiff_t i = 0; i < n - by; i++) after[i] |= from[i];
      for (ptrdiff_t i = 0; i < n - by; i++) to[i] |= next[i];
    } else {
      for (ptrdiff_t i = 0; i < n - by; i++) after[i] &= from[i];
      for (ptrdiff_t i = 0; i < n - by; i++) to[i] &= next[i];
    }
  }
}

// A map with the gaps of its pixels closed: the squares around them joined, and what is less than a square wide left out again.
static void close_gaps(const uint8_t *map, uint8_t *work, uint8_t *closed, ptrdiff_t h, ptrdiff_t w) {
  gather(map, work, h * w, w, true);
  for (ptrdiff_t y = 0; y < h; y++) gather(work + y * w, closed + y * w, w, 1, true);
  gather(closed, work, h * w, w, false);
  for (ptrdiff_t y = 0; y < h; y++) gather(work + y * w, closed + y * w, w, 1, false);
}

// Variance of a bending at rest, and elsewhere, for a variance of slopes of 1. A frame may have more noise at rest than the
// calibration's presses, or larger outliers, as after compression: the larger counts. If nothing is known, the smallest magnitudes of
// the frame tell its noise: at least 30 % are at rest. Of normal noise, 30 % of the magnitudes lie below 1/2.595 deviations, 95 % below
// 1.96. A depth without noise has 1e-3 1/mm, to which float32 rounds.
static int gains_of_frame(const float *bent, const float *noise, const bool *at_rest, const double *known, float *work, ptrdiff_t n,
                          float gains[2], int64_t step, ptrdiff_t count) {
  float found;
  const int status = magnitude_of_share(bent, noise, known == NULL ? NULL : at_rest, work, &found, step, known == NULL ? 0.3 : 0.95,
                                        count, n);
  if (status != OK) return status;
  if (known == NULL) {
    const double deviation = 2.595 * (double)found > 1e-3 ? 2.595 * (double)found : 1e-3;
    gains[0] = gains[1] = (float)(deviation * deviation);
  } else {
    const double deviation = (double)found / 1.96, own = deviation * deviation;
    gains[0] = (float)(known[0] > own ? known[0] : own), gains[1] = (float)known[1];
  }
  return OK;
}

enum { PRESSURE, SPREAD, AROUND, SURE, MAPS };  // free for the runs of regions once there is an outline

// `sigma`: of the depth, by which outlines are drawn. `noise`: variance of a slope at rest. `read`, `solved`, `at_rest`: deviations
// of the frame's slopes, and where the first holds; NULL if unknown. `gains`: variance of a mean's bending at rest, and elsewhere, then
// of a pixel's, for a variance of slopes of 1; NULL: the frame's noise is measured on every `step`-th pixel. `smooth`, `bent`: the
// surface and minus its Laplacian; `evidence`: square of the mean pressure over its variance. Returns the number of regions.
EXPORT int pressed_regions(const float *depth, const float *sigma, const float *noise, const float *read, const float *solved,
                           const bool *at_rest, const bool *known, const float *taps, const double *gains, float *smooth, float *bent,
                           float *evidence, uint16_t *labels, float *work, float along_x, float along_y, float stiffness, float factor,
                           float reach, int64_t margin, int64_t step, ptrdiff_t h, ptrdiff_t w, ptrdiff_t t, ptrdiff_t n) {
  // The mean, the mask and the maps; what only earlier steps need stands where a later one writes.
  const ptrdiff_t count = h * w, mask = (count + 3) / 4, left = n - (1 + MAPS) * count - mask, words = MAPS * count + left;
  float *mean = work, *maps[MAPS], *rest = work + n - left, *variance_here = evidence, *mean_bent = evidence;
  bool *contact = (bool *)(work + count), *outline = (bool *)labels, *closed = outline + count;
  if (left < 0 || words < runs_work(h, w)) return WRONG_SIZE;
  for (int k = 0; k < MAPS; k++) maps[k] = work + count + mask + k * count;
  const bool by_slopes = gains != NULL && read != NULL && solved != NULL && at_rest != NULL;
  const float *variance = by_slopes ? variance_here : noise;
  if (by_slopes) slope_variance(read, solved, at_rest, variance_here, count);
  else at_rest = NULL, gains = NULL;
  float of_mean[2], of_pixel[2];
  if (bent_surface(depth, taps, smooth, bent, rest, along_x, along_y, margin, h, w, t, left) != OK ||
      pressure_means(smooth, bent, sigma, variance, known, maps[PRESSURE], mean, maps[SPREAD], maps[AROUND], mean_bent,
                     rest, stiffness, SIGMAS, h, w, left) != OK ||
      gains_of_frame(mean_bent, noise, at_rest, gains, rest, left, of_mean, step, count) != OK ||
      gains_of_frame(bent, noise, at_rest, gains == NULL ? NULL : gains + 2, rest, left, of_pixel, step, count) != OK)
    return WRONG_SIZE;
  if (sure_pressure(maps[PRESSURE], mean, maps[SPREAD], sigma, maps[AROUND], noise, at_rest, known, maps[SURE], evidence, stiffness,
                    factor, of_mean[0], of_mean[1], of_pixel[0], of_pixel[1], count) == 0) {
    memset(labels, 0, (size_t)count * sizeof *labels);
    return 0;
  }
  if (contact_outline(maps[SURE], outline, rest, ENDS_AT, h, w, left) != OK) return WRONG_SIZE;
  close_gaps((const uint8_t *)outline, (uint8_t *)contact, (uint8_t *)closed, h, w);
  int32_t *runs = (int32_t *)maps[0];
  if (held_outline(outline, closed, known, mean, smooth, bent, contact, runs, stiffness, HELD_FROM, reach, h, w, words) != OK)
    return WRONG_SIZE;
  return label_regions(contact, labels, runs, h, w, words);
}
