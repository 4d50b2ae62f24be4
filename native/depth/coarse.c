// Means of maps over square cells, the coarse grid of a frame; and a variance on it at every pixel again.
#include "../bilinear.h"
#include "../select.h"

enum { SIDE = 4, CHANNELS = 3 };  // of a cell, px; the most channels of a map

static inline void add_row(const float *restrict row, float *restrict sums, ptrdiff_t n) {
  for (ptrdiff_t i = 0; i < n; i++) sums[i] += row[i];
}

// A map of `c` channels whose height and width are SIDE times `r` and `k`.
EXPORT int cell_means(const float *values, float *work, float *cells, ptrdiff_t h, ptrdiff_t w, ptrdiff_t c, ptrdiff_t n, ptrdiff_t r,
                      ptrdiff_t k) {
  if (h != SIDE * r || w != SIDE * k || n < w * c || c > CHANNELS) return WRONG_SIZE;
  const float share = 1.0f / (SIDE * SIDE);
  for (ptrdiff_t i = 0; i < r; i++) {
    memset(work, 0, (size_t)(w * c) * sizeof *work);
    for (ptrdiff_t y = 0; y < SIDE; y++) add_row(values + (SIDE * i + y) * w * c, work, w * c);
    float *out = cells + i * k * c;
    for (ptrdiff_t j = 0; j < k; j++)
      for (ptrdiff_t channel = 0; channel < c; channel++) {
        const float *at = work + SIDE * j * c + channel;
        out[j * c + channel] = share * ((at[0] + at[c]) + (at[2 * c] + at[3 * c]));
      }
  }
  return OK;
}

// The share of a mask in each cell.
EXPORT int cell_shares(const bool *mask, float *cells, ptrdiff_t h, ptrdiff_t w, ptrdiff_t r, ptrdiff_t k) {
  if (h != SIDE * r || w != SIDE * k) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < r; i++)
    for (ptrdiff_t j = 0; j < k; j++) {
      int count = 0;
      for (ptrdiff_t y = 0; y < SIDE; y++)
        for (ptrdiff_t x = 0; x < SIDE; x++) count += mask[(SIDE * i + y) * w + SIDE * j + x];
      cells[i * k + j] = (float)count / (SIDE * SIDE);
    }
  return OK;
}

// Takes the median of some values `c` apart off each of them: of those at rest, or of all where `rest` is NULL. `work`: 2 n.
static void take_median_off(float *values, const bool *rest, float *work, ptrdiff_t n, ptrdiff_t c) {
  ptrdiff_t count = 0;
  for (ptrdiff_t i = 0; i < n; i++) {
    work[count] = values[i * c];
    count += rest == NULL || rest[i];
  }
  const float middle = count > 0 ? median(work, count, (uint32_t *)(work + n)) : 0;
  for (ptrdiff_t i = 0; i < n; i++) values[i * c] -= middle;
}

// Cells at rest: those whose change, without what all have in common, has a square up to `most`, but `share` of them at least. What
// the slopes at rest have in common is taken off all slopes.
EXPORT int slopes_over_rest(float *change, float *slopes, bool *rest, float *work, float most, double share, ptrdiff_t r, ptrdiff_t k,
                            ptrdiff_t n) {
  const ptrdiff_t cells = r * k;
  ptrdiff_t count = 0;
  if (n < 3 * cells || cells < 1 || !(share >= 0 && share <= 1)) return WRONG_SIZE;
  for (int c = 0; c < CHANNELS; c++) take_median_off(change + c, NULL, work, cells, CHANNELS);
  float *square = work + 2 * cells;
  for (ptrdiff_t i = 0; i < cells; i++)
    square[i] = (square_of(change[3 * i]) + square_of(change[3 * i + 1])) + square_of(change[3 * i + 2]);
  for (ptrdiff_t i = 0; i < cells; i++) count += square[i] <= most;
  if ((double)count < share * (double)cells)
    most = kth_smallest(square, cells, (ptrdiff_t)(share * (double)(cells - 1)), (uint32_t *)work);
  for (ptrdiff_t i = 0; i < cells; i++) rest[i] = square[i] <= most;
  for (int c = 0; c < 2; c++) take_median_off(slopes + c, rest, work, cells, 2);
  return OK;
}

// The root of a variance (r, c) at every pixel, bilinearly; `most` where it is larger, and at lost pixels. `lost`:
// NULL where there are none.
EXPORT int root_at_pixels(const float *variance, const bool *lost, float *work, float *sigma, float most, ptrdiff_t r, ptrdiff_t c,
                          ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  const double down = (double)r / (double)h;
  float fraction;
  if (n < 4 * w) return WRONG_SIZE;
  struct rows_between rows = {variance, r, c, w, -1, (int32_t *)work, work + w, work + 2 * w, work + 3 * w};
  places_in_row(w, (double)c / (double)w, c, (int32_t *)work, work + w);
  for (ptrdiff_t y = 0; y < h; y++) {
    float *restrict out = sigma + y * w;
    hold_rows(&rows, between(y, down, r, &fraction));
    for (ptrdiff_t x = 0; x < w; x++) out[x] = smaller(sqrtf(rows.upper[x] + fraction * (rows.lower[x] - rows.upper[x])), most);
    for (ptrdiff_t x = 0; lost != NULL && x < w; x++) out[x] = lost[y * w + x] ? most : out[x];
  }
  return OK;
}
