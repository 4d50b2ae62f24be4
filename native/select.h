// The k-th smallest of many values and their median, without sorting them: bits are looked at from the highest on, and only
// values that agree in them are kept (radix selection).
#ifndef GELFORM_SELECT_H
#define GELFORM_SELECT_H
#include "common.h"

enum { DIGIT = 11, DIGITS = 1 << DIGIT };

// An integer that is ordered as its float is.
static inline uint32_t key_of(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits ^ (bits >> 31 ? 0xFFFFFFFFu : 0x80000000u);
}

static inline float value_of(uint32_t key) {
  const uint32_t bits = key ^ (key >> 31 ? 0x80000000u : 0xFFFFFFFFu);
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

// Keeps those of n keys whose digit at `shift` is that of the k-th smallest, which is then the k-th of those kept.
static inline ptrdiff_t keep_digit(uint32_t *keys, ptrdiff_t n, int shift, ptrdiff_t *k) {
  int32_t counts[DIGITS] = {0};
  ptrdiff_t digit = 0, kept = 0;
  for (ptrdiff_t i = 0; i < n; i++) counts[keys[i] >> shift & (DIGITS - 1)]++;
  for (; *k >= counts[digit]; digit++) *k -= counts[digit];
  for (ptrdiff_t i = 0; i < n; i++) {
    keys[kept] = keys[i];
    kept += (ptrdiff_t)(keys[i] >> shift & (DIGITS - 1)) == digit;
  }
  return kept;
}

// The k-th smallest, from 0, of n > k values, none of them NaN. `keys`: scratch of n.
static inline float kth_smallest(const float *values, ptrdiff_t n, ptrdiff_t k, uint32_t *keys) {
  for (ptrdiff_t i = 0; i < n; i++) keys[i] = key_of(values[i]);
  for (int shift = 32 - DIGIT; n > 1 && shift > -DIGIT; shift -= DIGIT) n = keep_digit(keys, n, shift > 0 ? shift : 0, &k);
  return value_of(keys[0]);
}

// Mean of the two middle ones of n > 0 values, of which the upper is the least above the lower or equal to it.
static inline float median(const float *values, ptrdiff_t n, uint32_t *keys) {
  const float lower = kth_smallest(values, n, (n - 1) / 2, keys);
  float above = INFINITY;
  ptrdiff_t not_above = 0;
  for (ptrdiff_t i = 0; i < n; i++) {
    not_above += values[i] <= lower;
    above = values[i] > lower && values[i] < above ? values[i] : above;
  }
  return (lower + (not_above > n / 2 ? lower : above)) / 2;
}

// Pixels of every `step`-th row and column.
static inline ptrdiff_t sampled(ptrdiff_t h, ptrdiff_t w, ptrdiff_t step) { return (h + step - 1) / step * ((w + step - 1) / step); }

EXPORT int medians_where(const float *values, const bool *chosen, int64_t step, float *work, float *medians, ptrdiff_t h,
                         ptrdiff_t w, ptrdiff_t c, ptrdiff_t n);

#endif
