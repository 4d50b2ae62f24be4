// What the errors of a frame's depth follow from, as means over the cells of a coarse grid, in one pass over the solved slopes.
#include "../bilinear.h"
#include "../select.h"
#include "contact/runs.h"

// Maps that are summed: squared slopes that are errors, the same for contacts, squared negative depths and where they count,
// depths, what steep faces add to slopes that are off in proportion (p, q), slopes of steep faces that may be missing (p, q), and
// pixels at rest.
enum { ERRORS, OF_CONTACT, BELOW_ZERO, FREE, DEPTH, ADDED_P, ADDED_Q, STEEP_P, STEEP_Q, AT_REST, MAPS };

struct numbers {
  float full, spill, rest_share, spill_of_contact, gain, doubted;
};

static inline void add_row(const struct numbers *restrict n, const float *restrict slopes, const float *restrict depth,
                           const bool *restrict at_rest, const bool *restrict known, const float *restrict read,
                           const float *restrict steep, float *restrict sums, ptrdiff_t w) {
  const float most = 2 * square_of(n->full), gain = square_of(n->gain), doubted = square_of(n->doubted);
  float *errors = sums, *of_contact = sums + w, *below = sums + 2 * w, *free = sums + 3 * w, *all = sums + 4 * w,
        *added_p = sums + 5 * w, *added_q = sums + 6 * w, *steep_p = sums + 7 * w, *steep_q = sums + 8 * w, *rest = sums + 9 * w;
  INDEPENDENT
  for (ptrdiff_t x = 0; x < w; x++) {
    const float p = slopes[2 * x], q = slopes[2 * x + 1], square = p * p + q * q;
    const float resting = at_rest[x] ? 1 : 0, moved = 1 - resting;
    const float noise = smaller(square, 2 * square_of(smaller(read[x], n->full)));
    errors[x] += resting * noise + moved * smaller(n->spill * square, most);
    const float doubted_noise = smaller(n->spill_of_contact * square, 2 * square_of(smaller(2 * read[x], n->full)));
    of_contact[x] += resting * n->rest_share * noise + moved * doubted_noise;
    const float low = smaller(depth[x], 0), counts = known[x] ? 1 : 0;  // what was filled in is no error of the frame
    below[x] += counts * 2 * low * low;
    free[x] += counts * larger(resting, low < 0 ? 1 : 0);
    all[x] += depth[x], rest[x] += resting;
    const float each = steep[x] * steep[x], doubt = each > doubted ? each : 0;
    const float per_slope = 1 / sqrtf(larger(square, 1e-12f)), missing = sqrtf(doubt) * per_slope;
    const float added = (sqrtf(gain * square + doubt) - sqrtf(gain * square)) * per_slope;
    added_p[x] += added * p, added_q[x] += added * q;
    steep_p[x] += missing * p, steep_q[x] += missing * q;
  }
}

// A row of cells from the sums of its rows of pixels; `each`: how many columns every cell has, 0 if not all have as many.
static inline void means_of_row(const float *restrict sums, const int32_t *restrict columns, ptrdiff_t each, ptrdiff_t rows,
                                float *restrict cells, ptrdiff_t c) {
  for (ptrdiff_t j = 0; j < c; j++) {
    const ptrdiff_t from = each > 0 ? j * each : columns[j], to = each > 0 ? from + each : columns[j + 1], count = rows * (to - from);
    float total = 0;
    for (ptrdiff_t x = from; x < to; x++) total += sums[x];
    cells[j] = total / (float)(count > 0 ? count : 1);  // none in images of a row
  }
}

// Cell (r, c) holds the rows from rows[r] to rows[r + 1] and the columns from columns[c] to columns[c + 1]. `own`: the squared negative
// depths of the whole frame, of pixels where they count, but of a share of `least` at least; and the same by the median of negative
// cells times `per_median`, if that is less. Returns 1 where float holds no mean.
EXPORT int depth_errors(const float *slopes, const float *depth, const bool *at_rest, const bool *known, const float *read, const float *steep,
                        const int32_t *rows, const int32_t *columns, float *work, float *cells, float *own, float full, float spill,
                        float rest_share, float spill_of_contact, float gain, float doubted, float least, float per_median, ptrdiff_t h,
                        ptrdiff_t w, ptrdiff_t row_ends, ptrdiff_t column_ends, ptrdiff_t n, ptrdiff_t maps, ptrdiff_t r, ptrdiff_t c) {
  const ptrdiff_t size = r * c;
  const struct numbers values = {full, square_of(spill), rest_share, square_of(spill_of_contact), gain, doubted};
  if (maps != MAPS || row_ends != r + 1 || column_ends != c + 1 || n < MAPS * w || n < 2 * size || rows[r] > h || columns[c] > w) return WRONG_SIZE;
  bool even = true;
  for (ptrdiff_t j = 0; j <= c; j++) even &= columns[j] == USUAL * j;
  for (ptrdiff_t i = 0; i < r; i++) {
    memset(work, 0, (size_t)(MAPS * w) * sizeof *work);
    for (ptrdiff_t y = rows[i]; y < rows[i + 1]; y++)
      add_row(&values, slopes + 2 * y * w, depth + y * w, at_rest + y * w, known + y * w, read + y * w, steep + y * w, work, w);
    for (ptrdiff_t map = 0; map < MAPS; map++) {
      float *row = cells + (map * r + i) * c;
      if (even) means_of_row(work + map * w, columns, USUAL, rows[i + 1] - rows[i], row, c);
      else means_of_row(work + map * w, columns, 0, rows[i + 1] - rows[i], row, c);
    }
  }
  if (times_zero(cells, MAPS * size) != 0) return 1;
  const float *below = cells + BELOW_ZERO * size;
  ptrdiff_t negative = 0;
  for (ptrdiff_t i = 0; i < size; i++) {
    work[negative] = below[i];
    negative += below[i] > 0;
  }
  own[0] = (sum(below, size) / (float)size) / larger(sum(cells + FREE * size, size) / (float)size, least);
  own[1] = negative > 0 ? smaller(per_median * median(work, negative, (uint32_t *)(work + size)), own[0]) : 0;
  return OK;
}

// A map (r, c) over its median in the largest part where the share at rest is above `share`, which becomes 0; as it is without one.
EXPORT int over_rest(float *map, const float *at_rest, float *work, float share, ptrdiff_t r, ptrdiff_t c, ptrdiff_t n) {
  const ptrdiff_t size = r * c, words = runs_work(r, c);
  struct run *runs = (struct run *)work;
  float *values = work + words;
  uint8_t *resting = (uint8_t *)(values + 2 * size);
  if (n < words + 2 * size + (size + 3) / 4) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < size; i++) resting[i] = at_rest[i] > share;
  const int32_t count = find_runs(resting, 1, EDGES, runs, r, c);
  int32_t largest = 0;
  ptrdiff_t taken = 0;
  for (int32_t k = 0; k < count; k++) {
    const int32_t first = first_of(runs, k);
    if (first != k) runs[first].area += runs[k].area;
  }
  for (int32_t k = 0; k < count; k++)
    if (runs[k].parent == k && runs[k].area > runs[largest].area) largest = k;
  for (int32_t k = 0; k < count; k++)
    if (first_of(runs, k) == largest)
      for (ptrdiff_t x = runs[k].from; x < runs[k].to; x++) values[taken++] = map[runs[k].y * c + x], map[runs[k].y * c + x] = NAN;
  const float middle = taken > 0 ? median(values, taken, (uint32_t *)(values + size)) : 0;
  for (ptrdiff_t i = 0; i < size; i++) map[i] = map[i] == map[i] ? map[i] - middle : 0;
  return OK;
}

// The share of what negative depths have beyond a variance that comes on top of it.
static inline float pulled(float own, float variance, float pull) { return variance + pull * larger(own - variance, 0); }

enum { SPREAD, OWN, SINGLE, STATED, FOR_CONTACT, OUTLINE, DEEPEST, VARIANCES };

// The variances (VARIANCES, r, c) of a depth: by the slopes, and by its negative depths around; by both, without what depths have in
// common; with that, `common`, which is taken over rest; for contacts, for outlines, and of the deepest contact. `filtered`: what `cells`
// make around, the spreads but for the factor of a free border. `of_frame`, `usual`: of negative depths in the whole frame.
EXPORT int depth_variances(float *common, const float *at_rest, const float *filtered, const float *border, float *work, float share,
                           float *variances, float of_frame, float usual, float pull, float least_free, float least, ptrdiff_t r,
                           ptrdiff_t c, ptrdiff_t n) {
  const ptrdiff_t size = r * c;
  const float *of_contact = filtered + OF_CONTACT * size, *below = filtered + BELOW_ZERO * size, *free = filtered + FREE * size;
  const int status = over_rest(common, at_rest, work, share, r, c, n);
  if (status != OK) return status;
  for (ptrdiff_t i = 0; i < size; i++) {
    const float spread = larger(filtered[i] * border[i], least), contact = larger(of_contact[i] * border[i], least);
    const float own = below[i] / larger(free[i], least_free), single = pulled(own, spread, pull);
    variances[SPREAD * size + i] = spread, variances[OWN * size + i] = own, variances[SINGLE * size + i] = single;
    variances[STATED * size + i] = single + common[i] * common[i];
    variances[FOR_CONTACT * size + i] = pulled(larger(own, of_frame), contact, pull);
    variances[OUTLINE * size + i] = pull * larger(own, usual);
    variances[DEEPEST * size + i] = pulled(usual, contact, pull);
  }
  return OK;
}
