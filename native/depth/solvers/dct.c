// Uniform least squares: the right side, and elimination along columns between the cosine transforms along rows.
// Rows of work arrays may be longer than the frame's: `stride` of them, of which `w` count.
#include "../../common.h"

int cosine_rows(float *rows, const float *turns, const float *twists, float *work, int32_t back, ptrdiff_t h, ptrdiff_t stride,
                ptrdiff_t half, ptrdiff_t knots, ptrdiff_t n);

// Inner pixels of a row: neighbors' slopes along it, and across from the rows above and below. p and q alternate: every other
// value that is worked out is of no use, which is quicker than to part them first.
static void inner_pixels(const float *here, const float *above, const float *below, float sx, float sa, float sb, float *restrict right,
                         ptrdiff_t w) {
  ptrdiff_t j = 1;
  for (; 2 * j + 1 + LANES <= 2 * w - 1; j += LANES / 2) {
    const lanes along = load_lanes(here + 2 * j - 2) - load_lanes(here + 2 * j + 2);
    const lanes flow = sx * along + (sa * load_lanes(above + 2 * j + 1) - sb * load_lanes(below + 2 * j + 1));
    for (int k = 0; k < LANES / 2; k++) right[j + k] = flow[2 * k];
  }
  for (; j < w - 1; j++)
    right[j] = sx * (here[2 * j - 2] - here[2 * j + 2]) + (sa * above[2 * j + 1] - sb * below[2 * j + 1]);
}

// Divergence of a pixel: inflow over its edges minus outflow. Beyond the border the slope is mirrored with its sign turned.
EXPORT int dct_right_side(const float *gradients, float *right, float scale_x, float scale_y, ptrdiff_t h, ptrdiff_t w,
                          ptrdiff_t stride) {
  const ptrdiff_t last = w - 1;
  for (ptrdiff_t i = 0; i < h; i++) {
    const float *here = gradients + 2 * i * w, *above = i > 0 ? here - 2 * w : here, *below = i < h - 1 ? here + 2 * w : here;
    const float sa = i > 0 ? scale_y : -scale_y, sb = i < h - 1 ? scale_y : -scale_y;
    float *out = right + i * stride;
    inner_pixels(here, above, below, scale_x, sa, sb, out, w);
    out[0] = sa * above[1] - sb * below[1];
    if (last == 0) continue;
    out[0] -= scale_x * (here[0] + here[2]);
    out[last] = sa * above[2 * last + 1] - sb * below[2 * last + 1] + scale_x * (here[2 * last - 2] + here[2 * last]);
  }
  return OK;
}

enum { WIDEST_PRODUCT = 128 };

// Columns `first` ... of a row times a table, as many lanes as said, at once: none waits for the one before.
static inline void multiply_columns(const float *before, const float *table, float *row, ptrdiff_t first, int count, ptrdiff_t w) {
  lanes totals[3] = {{0}, {0}, {0}};
  for (ptrdiff_t n = 0; n < w; n++)
    for (int k = 0; k < count; k++) totals[k] += before[n] * load_lanes(table + n * w + first + k * LANES);
  for (int k = 0; k < count; k++) store_lanes(row + first + k * LANES, totals[k]);
}

// Multiply every row by a table in place, as a cosine transform of few columns is done soonest.
EXPORT int dct_product(float *rows, const float *table, ptrdiff_t h, ptrdiff_t stride, ptrdiff_t w) {
  float before[WIDEST_PRODUCT];
  if (w > WIDEST_PRODUCT || w > stride) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < h; i++) {
    float *restrict row = rows + i * stride;
    ptrdiff_t k = 0;
    memcpy(before, row, w * sizeof *row);
    for (; k + 3 * LANES <= w; k += 3 * LANES) multiply_columns(before, table, row, k, 3, w);
    for (; k + 2 * LANES <= w; k += 2 * LANES) multiply_columns(before, table, row, k, 2, w);
    for (; k + LANES <= w; k += LANES) multiply_columns(before, table, row, k, 1, w);
    for (ptrdiff_t j = k; j < w; j++) row[j] = 0;
    for (ptrdiff_t n = 0; n < w; n++)
      for (ptrdiff_t j = k; j < w; j++) row[j] += before[n] * table[n * w + j];
  }
  return OK;
}

// Column 0 has eigenvalue 0: sum the right side twice, in double, and remove the mean.
static void solve_constants(float *v, ptrdiff_t stride, ptrdiff_t h) {
  double flux = 0, value = 0, total = 0;
  for (ptrdiff_t i = 0; i < h; i++) {
    flux += v[i * stride];
    v[i * stride] = (float)value;
    total += value;
    value -= flux;
  }
  const double mean = total / h;
  for (ptrdiff_t i = 0; i < h; i++) v[i * stride] = (float)(v[i * stride] - mean);
}

static void down(float *restrict row, const float *restrict above, const float *restrict pivot, ptrdiff_t from, ptrdiff_t to) {
  for (ptrdiff_t k = from; k < to; k++) row[k] = (row[k] + above[k]) * pivot[k];
}

static void up(float *restrict row, const float *restrict below, const float *restrict pivot, ptrdiff_t from, ptrdiff_t to) {
  for (ptrdiff_t k = from; k < to; k++) row[k] += below[k] * pivot[k];
}

// Solve the tridiagonal system of every column in place. Row i of `pivots` holds for columns before `splits[i]`; those from
// there on have settled at its last row. `end`: pivots of the last equation.
EXPORT int dct_sweep(float *spectrum, const float *pivots, const int64_t *splits, const float *end, ptrdiff_t h,
                     ptrdiff_t stride, ptrdiff_t rows, ptrdiff_t w) {
  const float *settled = pivots + (rows - 1) * w;
  solve_constants(spectrum, stride, h);
  for (ptrdiff_t k = 1; k < w; k++) spectrum[k] *= h > 1 ? pivots[k] : end[k];
  for (ptrdiff_t i = 1; i < h - 1; i++) {
    float *row = spectrum + i * stride;
    down(row, row - stride, pivots + i * w, 1, splits[i]);
    down(row, row - stride, settled, splits[i], w);
  }
  float *row = spectrum + (h - 1) * stride;
  if (h > 1) down(row, row - stride, end, 1, w);
  for (ptrdiff_t i = h - 2; i >= 0; i--) {
    row = spectrum + i * stride;
    up(row, row + stride, pivots + i * w, 1, splits[i]);
    up(row, row + stride, settled, splits[i], w);
  }
  return OK;
}

// The depth of gradients, or of right sides in place where there are none: all passes of a width that `cosine_rows` transforms.
EXPORT int dct_passes(float *spectrum, const float *gradients, const float *turns, const float *twists, const float *pivots,
                      const int64_t *splits, const float *end, float *work, float scale_x, float scale_y, ptrdiff_t h,
                      ptrdiff_t stride, ptrdiff_t w, ptrdiff_t half, ptrdiff_t knots, ptrdiff_t rows, ptrdiff_t n) {
  if (w != 2 * half) return WRONG_SIZE;
  if (gradients != NULL) dct_right_side(gradients, spectrum, scale_x, scale_y, h, w, stride);
  const int status = cosine_rows(spectrum, turns, twists, work, 0, h, stride, half, knots, n);
  if (status != OK) return status;
  dct_sweep(spectrum, pivots, splits, end, h, stride, rows, w);
  return cosine_rows(spectrum, turns, twists, work, 1, h, stride, half, knots, n);
}

static void turn_over(const float *restrict from, float *restrict to, ptrdiff_t h, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++)
    for (ptrdiff_t y = 0; y < h; y++) to[x * h + y] = from[y * w + x];
}

// Multiplies the cosine modes of maps (m, h, w) by gains (m, w, h), in place; roots of 1 as for `cosine_rows`, of both sides.
EXPORT int cosine_filter(float *maps, const float *gains, const float *turns_x, const float *twists_x, const float *turns_y,
                         const float *twists_y, float *work, ptrdiff_t m, ptrdiff_t h, ptrdiff_t w, ptrdiff_t half_x, ptrdiff_t knots_x,
                         ptrdiff_t half_y, ptrdiff_t knots_y, ptrdiff_t n) {
  const ptrdiff_t size = h * w, left = n - size;
  float *turned = work, *rest = work + size;
  if (left < 0 || w != 2 * half_x || h != 2 * half_y) return WRONG_SIZE;
  for (ptrdiff_t k = 0; k < m; k++) {
    float *map = maps + k * size;
    int status = cosine_rows(map, turns_x, twists_x, rest, 0, h, w, half_x, knots_x, left);
    turn_over(map, turned, h, w);
    if (status == OK) status = cosine_rows(turned, turns_y, twists_y, rest, 0, w, h, half_y, knots_y, left);
    if (status != OK) return status;
    for (ptrdiff_t i = 0; i < size; i++) turned[i] *= gains[k * size + i];
    cosine_rows(turned, turns_y, twists_y, rest, 1, w, h, half_y, knots_y, left);
    turn_over(turned, map, w, h);
    cosine_rows(map, turns_x, twists_x, rest, 1, h, w, half_x, knots_x, left);
  }
  return OK;
}
