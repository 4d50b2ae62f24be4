// Means of maps over square cells, the coarse grid of a frame; and a variance on it at every pixel again.
#include "../bilinear.h"
#include "../select.h"

enum { CHANNELS = 3 };  // the most of a map

// The pixels of a line of n from which cell `i` of `count` takes a part, and how much of the first and of the last.
struct part {
  int32_t first, last;
  float of_first, of_last;
};

static inline struct part part_of(ptrdiff_t i, ptrdiff_t n, ptrdiff_t count) {
  const double from = (double)(i * n) / (double)count, to = (double)((i + 1) * n) / (double)count;
  const int32_t first = (int32_t)((i * n) / count), last = (int32_t)(((i + 1) * n - 1) / count);
  if (first == last) return (struct part){first, last, (float)(to - from), 0};
  return (struct part){first, last, (float)((double)(first + 1) - from), (float)(to - (double)last)};
}

// The part's sum of values `c` apart.
static inline float sum_of(struct part part, const float *values, ptrdiff_t c) {
  float sum = part.of_first * values[part.first * c] + part.of_last * values[part.last * c];
  for (ptrdiff_t x = part.first + 1; x < part.last; x++) sum += values[x * c];
  return sum;
}

static inline void add_row(const float *restrict row, float *restrict sums, float weight, ptrdiff_t n) {
  for (ptrdiff_t i = 0; i < n; i++) sums[i] += weight * row[i];
}

// A row of cells from the sums of its rows of pixels. `even`: each has USUAL whole columns.
static inline void cells_of_row(const struct part *restrict parts, bool even, const float *restrict sums, const float *restrict area,
                                float whole, float *restrict means, float *restrict shares, ptrdiff_t k, ptrdiff_t c) {
  for (ptrdiff_t j = 0; j < k; j++) {
    const int32_t first = (int32_t)j * USUAL;
    const struct part part = even ? (struct part){first, first + USUAL - 1, 1, 1} : parts[j];
    const float own = area != NULL ? sum_of(part, area, 1) : whole, per = own > 0 ? 1 / own : 0;
    for (ptrdiff_t channel = 0; channel < c; channel++) means[j * c + channel] = per * sum_of(part, sums + channel, c);
    shares[j] = own / whole;
  }
}

// Means (r, k, c) of the seen pixels of a map over as many cells, 0 in a cell without any; and the share (r, k) of its area that
// they are. All pixels are seen where `seen` is NULL; no channel (c = 0) needs no values.
EXPORT int cell_means(const float *values, const bool *seen, float *work, float *cells, float *shares, ptrdiff_t h, ptrdiff_t w,
                      ptrdiff_t c, ptrdiff_t n, ptrdiff_t r, ptrdiff_t k) {
  if (h < 1 || w < 1 || n < (c + 1) * w + 4 * k || c > CHANNELS) return WRONG_SIZE;
  float *sums = work, *area = work + w * c;
  struct part *parts = (struct part *)(area + w);
  for (ptrdiff_t j = 0; j < k; j++) parts[j] = part_of(j, w, k);
  const bool even = w == USUAL * k;
  const float whole = (float)((double)h / (double)r * (double)w / (double)k);
  for (ptrdiff_t i = 0; i < r; i++) {
    const struct part down = part_of(i, h, r);
    memset(work, 0, (size_t)((c + 1) * w) * sizeof *work);
    for (ptrdiff_t y = down.first; y <= down.last; y++) {
      const float weight = y == down.first ? down.of_first : y == down.last ? down.of_last : 1;
      if (seen != NULL) add_seen_row(values + y * w * c, seen + y * w, sums, area, weight, w, c);
      else add_row(values + y * w * c, sums, weight, w * c);
    }
    const float *of_row = seen != NULL ? area : NULL;
    float *means = cells + i * k * c, *of_cells = shares + i * k;
    if (even && c == 3) cells_of_row(parts, true, sums, of_row, whole, means, of_cells, k, 3);
    else if (even && c == 2) cells_of_row(parts, true, sums, of_row, whole, means, of_cells, k, 2);
    else cells_of_row(parts, false, sums, of_row, whole, means, of_cells, k, c);
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

// Means of a frame's color change and slopes over cells, over rest if every cell has a seen pixel; returns the number of cells
// without any.
EXPORT int cells_over_rest(const float *change, const float *slopes, const bool *seen, float *work, float *change_cells,
                           float *slope_cells, float *shares, bool *rest, float most, double share, ptrdiff_t h, ptrdiff_t w,
                           ptrdiff_t n, ptrdiff_t r, ptrdiff_t k) {
  int status = cell_means(change, seen, work, change_cells, shares, h, w, CHANNELS, n, r, k), unknown = 0;
  if (status == OK) status = cell_means(slopes, seen, work, slope_cells, shares, h, w, 2, n, r, k);
  if (status != OK) return status;
  for (ptrdiff_t i = 0; i < r * k; i++) unknown += !(shares[i] > 0);
  return unknown ? unknown : slopes_over_rest(change_cells, slope_cells, rest, work, most, share, r, k, n);
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
