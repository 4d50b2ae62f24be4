// Unknown pixels from a pyramid of averages of known ones. A flipped map is filled as the map is, but for rounding.
#include "../common.h"

// The pixels of a line of n that make the pixel `i` of its coarser line, and their weights: two, or three about every
// second one where n is odd, so that the coarser line of a flipped line is the flipped coarser line. The second one lies at
// the coarser pixel's very place.
struct taps {
  ptrdiff_t first;
  int count;
  float weight[3];
};

static inline struct taps taps_of(ptrdiff_t i, ptrdiff_t n) {
  if (n % 2 == 0) return (struct taps){2 * i, 2, {1, 1}};
  if (i == 0) return (struct taps){0, n > 1 ? 2 : 1, {4, 1}};
  return (struct taps){2 * i - 1, 2 * i + 1 < n ? 3 : 2, {1, 4, 1}};
}

// The coarser level: means of the known pixels, and whether any is. `work`: a row's sums and weights.
EXPORT int coarser_known(const float *values, const bool *known, float *work, float *coarse, bool *coarse_known, ptrdiff_t h,
                         ptrdiff_t w, ptrdiff_t c, ptrdiff_t n, ptrdiff_t rows, ptrdiff_t columns) {
  if (rows != (h + 1) / 2 || columns != (w + 1) / 2 || n < (c + 1) * w) return WRONG_SIZE;
  float *sums = work, *weights = work + w * c;
  for (ptrdiff_t i = 0; i < rows; i++) {
    const struct taps down = taps_of(i, h);
    memset(work, 0, (size_t)((c + 1) * w) * sizeof *work);
    for (ptrdiff_t y = 0; y < down.count; y++) {
      const ptrdiff_t row = (down.first + y) * w;
      add_seen_row(values + row * c, known + row, sums, weights, down.weight[y], w, c);
    }
    for (ptrdiff_t j = 0; j < columns; j++, coarse += c) {
      const struct taps across = taps_of(j, w);
      float whole = 0;
      for (int x = 0; x < across.count; x++) whole += across.weight[x] * weights[across.first + x];
      *coarse_known++ = whole > 0;
      for (ptrdiff_t k = 0; k < c; k++) {
        float sum = 0;
        for (int x = 0; x < across.count; x++) sum += across.weight[x] * sums[(across.first + x) * c + k];
        coarse[k] = whole > 0 ? sum / whole : 0;
      }
    }
  }
  return OK;
}

// The coarse pixels on both sides of a pixel of a line of n, and the share of the nearer one.
struct sides {
  ptrdiff_t near, far;
  float share;
};

static inline struct sides sides_of(ptrdiff_t pixel, ptrdiff_t n) {
  if (n % 2 == 1) return (struct sides){pixel / 2, (pixel + 1) / 2, 0.5f};
  const ptrdiff_t next = pixel / 2 + 2 * (pixel % 2) - 1;
  return (struct sides){pixel / 2, next < 0 ? 0 : next > n / 2 - 1 ? n / 2 - 1 : next, 0.75f};
}

static void interpolate(const float *coarse, float *value, ptrdiff_t i, ptrdiff_t j, ptrdiff_t h, ptrdiff_t w,
                        ptrdiff_t c) {
  const struct sides down = sides_of(i, h), across = sides_of(j, w);
  const ptrdiff_t columns = (w + 1) / 2, left = across.near * c, right = across.far * c;
  const float *near = coarse + down.near * columns * c, *far = coarse + down.far * columns * c;
  for (ptrdiff_t k = 0; k < c; k++) {
    const float on_near = across.share * near[left + k] + (1 - across.share) * near[right + k];
    const float on_far = across.share * far[left + k] + (1 - across.share) * far[right + k];
    value[k] = down.share * on_near + (1 - down.share) * on_far;
  }
}

// Unknown pixels side by side in one row.
struct run {
  int32_t row, first, last;
};

static ptrdiff_t runs_of_unknown(const bool *known, struct run *runs, ptrdiff_t h, ptrdiff_t w) {
  ptrdiff_t count = 0;
  for (ptrdiff_t i = 0; i < h; i++)
    for (ptrdiff_t j = 0; j < w; j++) {
      if (known[i * w + j]) continue;
      if (j == 0 || known[i * w + j - 1]) runs[count++] = (struct run){(int32_t)i, (int32_t)j, 0};
      runs[count - 1].last = (int32_t)j;
    }
  return count;
}

// n values become the mean of their neighbors, of which those beside them are `left` and `right` values away.
static inline void relax(const float *above, const float *here, const float *below, float *relaxed, ptrdiff_t left,
                         ptrdiff_t right, ptrdiff_t n) {
  INDEPENDENT
  for (ptrdiff_t x = 0; x < n; x++)
    relaxed[x] = 0.25f * ((above[x] + below[x]) + (here[x - left] + here[x + right]));
}

// At the border of the map, a pixel is its own neighbor.
static inline void relax_run(const float *values, float *relaxed, struct run run, ptrdiff_t h, ptrdiff_t w, ptrdiff_t c) {
  const ptrdiff_t up = run.row > 0 ? w * c : 0, down = run.row < h - 1 ? w * c : 0, row = run.row * w * c;
  const float *here = values + row;
  relaxed += row;
  ptrdiff_t first = run.first * c, end = (run.last + 1) * c;
  if (run.first == 0) {
    relax(here - up, here, here + down, relaxed, 0, w > 1 ? c : 0, c);
    first = c;
  }
  if (run.last == w - 1 && first < end) {
    end -= c;
    relax(here + end - up, here + end, here + end + down, relaxed + end, c, 0, c);
  }
  relax(here + first - up, here + first, here + first + down, relaxed + first, c, c, end - first);
}

// Unknown pixels from the coarser level, bilinearly; then relaxed `pairs` times there and back between two maps, all at
// once: no direction comes first.
EXPORT int fill_from_coarser(const float *coarse, float *values, float *work, int32_t *runs, const bool *known,
                             int32_t pairs, ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t c, ptrdiff_t h, ptrdiff_t w,
                             ptrdiff_t of_run) {
  if (rows != (h + 1) / 2 || columns != (w + 1) / 2 || of_run * sizeof *runs != sizeof(struct run)) return WRONG_SIZE;
  struct run *all = (struct run *)runs;
  const ptrdiff_t count = runs_of_unknown(known, all, h, w);
  for (struct run *run = all; run < all + count; run++)
    for (ptrdiff_t j = run->first; j <= run->last; j++)
      interpolate(coarse, values + (run->row * w + j) * c, run->row, j, h, w, c);
  memcpy(work, values, h * w * c * sizeof *values);
  for (int32_t k = 0; k < pairs; k++) {
    for (struct run *run = all; run < all + count; run++) relax_run(values, work, *run, h, w, c);
    for (struct run *run = all; run < all + count; run++) relax_run(work, values, *run, h, w, c);
  }
  return OK;
}
