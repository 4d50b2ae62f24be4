// What the errors of a frame's depth follow from, as means over the cells of a coarse grid, in one pass over the solved slopes.
#include "../common.h"

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

// Cell (r, c) holds the rows from rows[r] to rows[r + 1] and the columns from columns[c] to columns[c + 1].
EXPORT int depth_errors(const float *slopes, const float *depth, const bool *at_rest, const bool *known, const float *read, const float *steep,
                        const int32_t *rows, const int32_t *columns, float *work, float *cells, float full, float spill,
                        float rest_share, float spill_of_contact, float gain, float doubted, ptrdiff_t h, ptrdiff_t w,
                        ptrdiff_t row_ends, ptrdiff_t column_ends, ptrdiff_t n, ptrdiff_t maps, ptrdiff_t r, ptrdiff_t c) {
  const struct numbers values = {full, square_of(spill), rest_share, square_of(spill_of_contact), gain, doubted};
  if (maps != MAPS || row_ends != r + 1 || column_ends != c + 1 || n < MAPS * w || rows[r] > h || columns[c] > w) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < r; i++) {
    memset(work, 0, (size_t)(MAPS * w) * sizeof *work);
    for (ptrdiff_t y = rows[i]; y < rows[i + 1]; y++)
      add_row(&values, slopes + 2 * y * w, depth + y * w, at_rest + y * w, known + y * w, read + y * w, steep + y * w, work, w);
    for (ptrdiff_t map = 0; map < MAPS; map++)
      for (ptrdiff_t j = 0; j < c; j++) {
        float total = 0;
        for (ptrdiff_t x = columns[j]; x < columns[j + 1]; x++) total += work[map * w + x];
        const ptrdiff_t count = (rows[i + 1] - rows[i]) * (columns[j + 1] - columns[j]);  // none in images of a row
        cells[(map * r + i) * c + j] = total / (float)(count > 0 ? count : 1);
      }
  }
  return OK;
}
