// Shared by every kernel: the mark of exported functions, and sums whose order no instruction set changes.
#ifndef GELFORM_COMMON_H
#define GELFORM_COMMON_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

// A kernel returns one of these, or a positive number that its caller understands.
enum { OK = 0, NO_MEMORY = -1, WRONG_SIZE = -2 };

// A float sum has to be taken in one fixed order, or wider vectors would change its last bits. Value j goes to lane
// j % LANES, whatever the vectors' width; the lanes are added from the first to the last.
enum { LANES = 16 };

static inline float lanes_total(const float lanes[LANES]) {
  float total = 0;
  for (int k = 0; k < LANES; k++) total += lanes[k];
  return total;
}

static inline float sum(const float *restrict a, ptrdiff_t n) {
  float lanes[LANES] = {0};
  ptrdiff_t j = 0;
  for (; j + LANES <= n; j += LANES)
    for (int k = 0; k < LANES; k++) lanes[k] += a[j + k];
  for (int k = 0; j + k < n; k++) lanes[k] += a[j + k];
  return lanes_total(lanes);
}

static inline float dot(const float *a, const float *b, ptrdiff_t n) {
  float lanes[LANES] = {0};
  ptrdiff_t j = 0;
  for (; j + LANES <= n; j += LANES)
    for (int k = 0; k < LANES; k++) lanes[k] += a[j + k] * b[j + k];
  for (int k = 0; j + k < n; k++) lanes[k] += a[j + k] * b[j + k];
  return lanes_total(lanes);
}

// LANES values side by side. GCC and clang make of their arithmetic what the instruction set has: for loops over pixels
// whose sums should stay in registers, where plain arrays would be stored and loaded at every step.
typedef float lanes __attribute__((vector_size(LANES * sizeof(float))));

static inline lanes load_lanes(const float *values) {
  lanes x;
  memcpy(&x, values, sizeof x);
  return x;
}

static inline void store_lanes(float *values, lanes x) { memcpy(values, &x, sizeof x); }

// Both in turn: p[0], q[0], p[1], ...
static inline void store_in_turn(float *values, lanes p, lanes q) {
  lanes first, last;
  for (int k = 0; k < LANES / 2; k++) {
    first[2 * k] = p[k], first[2 * k + 1] = q[k];
    last[2 * k] = p[k + LANES / 2], last[2 * k + 1] = q[k + LANES / 2];
  }
  store_lanes(values, first), store_lanes(values + LANES, last);
}

// Before a loop: its iterations do not depend on each other, though the compiler cannot see it.
#if defined(__clang__)
#define INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#elif defined(__GNUC__)
#define INDEPENDENT _Pragma("GCC ivdep")
#else
#define INDEPENDENT
#endif

static inline float square_of(float x) { return x * x; }

// Written as comparisons, which become one vector instruction each; fminf and fmaxf treat NaN specially and do not.
static inline float smaller(float a, float b) { return a < b ? a : b; }
static inline float larger(float a, float b) { return a > b ? a : b; }

// The largest magnitude, in lanes as sums are; NaN is passed over.
static inline float largest_magnitude(const float *restrict a, ptrdiff_t n) {
  float lanes[LANES] = {0};
  ptrdiff_t j = 0;
  for (; j + LANES <= n; j += LANES)
    for (int k = 0; k < LANES; k++) lanes[k] = larger(fabsf(a[j + k]), lanes[k]);
  for (; j < n; j++) lanes[0] = larger(fabsf(a[j]), lanes[0]);
  for (int k = 1; k < LANES; k++) lanes[0] = larger(lanes[k], lanes[0]);
  return lanes[0];
}

// 0 where every value is finite, else NaN: x * 0 is 0, but NaN for NaN and for infinity, and NaN survives a sum.
static inline float times_zero(const float *restrict a, ptrdiff_t n) {
  float lanes[LANES] = {0};
  ptrdiff_t j = 0;
  for (; j + LANES <= n; j += LANES)
    for (int k = 0; k < LANES; k++) lanes[k] += a[j + k] * 0.0f;
  for (; j < n; j++) lanes[0] += a[j] * 0.0f;
  return lanes_total(lanes);
}

struct range {
  float low, high;
};

// The least and the largest value, of n > 0, in lanes as sums are.
static inline struct range range_of(const float *restrict a, ptrdiff_t n) {
  float low[LANES], high[LANES];
  ptrdiff_t j = 0;
  for (int k = 0; k < LANES; k++) low[k] = high[k] = a[0];
  for (; j + LANES <= n; j += LANES)
    for (int k = 0; k < LANES; k++) low[k] = smaller(a[j + k], low[k]), high[k] = larger(a[j + k], high[k]);
  for (; j < n; j++) low[0] = smaller(a[j], low[0]), high[0] = larger(a[j], high[0]);
  for (int k = 1; k < LANES; k++) low[0] = smaller(low[k], low[0]), high[0] = larger(high[k], high[0]);
  return (struct range){low[0], high[0]};
}

static inline float clamp(float x, float low, float high) { return smaller(larger(x, low), high); }

// A row of w pixels of c channels, weighted, to `sums`; the weights of its seen pixels to `area`. Others count as nothing.
static inline void add_seen(const float *restrict row, const bool *restrict seen, float *restrict sums, float *restrict area,
                            float weight, ptrdiff_t w, ptrdiff_t c) {
  for (ptrdiff_t x = 0; x < w; x++) {
    const float own = seen[x] ? weight : 0;
    area[x] += own;
    for (ptrdiff_t k = 0; k < c; k++) sums[x * c + k] += own * row[x * c + k];
  }
}

// The same, compiled for each usual number of channels.
static inline void add_seen_row(const float *row, const bool *seen, float *sums, float *area, float weight, ptrdiff_t w, ptrdiff_t c) {
  if (c == 1) add_seen(row, seen, sums, area, weight, w, 1);
  else if (c == 2) add_seen(row, seen, sums, area, weight, w, 2);
  else if (c == 3) add_seen(row, seen, sums, area, weight, w, 3);
  else if (c == 0) add_seen(row, seen, sums, area, weight, w, 0);
  else add_seen(row, seen, sums, area, weight, w, c);
}

#endif
