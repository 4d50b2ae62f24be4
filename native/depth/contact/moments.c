// Moments of labeled regions, which area, centroid, axes, volume and deepest point follow from; and which regions a contact consists of.
#include "../../bilinear.h"
#include "steps.h"

enum { COUNT, SUM_X, SUM_Y, SUM_XX, SUM_XY, SUM_YY, SUM_Z, MAX_Z, X_OF_MAX, Y_OF_MAX, MIN_X, MAX_X, MIN_Y, MAX_Y, FIGURES };

// 0 + 1 + 4 + ... + (n - 1)^2
static inline int64_t squares_below(int64_t n) { return (n - 1) * n * (2 * n - 1) / 6; }

// Depths are added in the order of the pixels; of the deepest the first counts.
static inline void take_in_depths(double *of, const float *depth, ptrdiff_t first, ptrdiff_t end, ptrdiff_t y) {
  double total = of[SUM_Z], most = of[COUNT] == 0 ? -INFINITY : of[MAX_Z];
  ptrdiff_t deepest = -1;
  for (ptrdiff_t x = first; x < end; x++) {
    total += depth[x];
    if (depth[x] > most) most = depth[x], deepest = x;
  }
  of[SUM_Z] = total, of[MAX_Z] = most;
  if (deepest >= 0) of[X_OF_MAX] = (double)deepest, of[Y_OF_MAX] = (double)y;
}

// A run of a region's pixels in row y. Whole numbers add up exactly in doubles.
static inline void take_in(double *of, const float *depth, ptrdiff_t first, ptrdiff_t end, ptrdiff_t y) {
  const int64_t count = end - first, sum = (first + end - 1) * count / 2;
  take_in_depths(of, depth, first, end, y);
  if (of[COUNT] == 0) of[MIN_X] = (double)first, of[MAX_X] = (double)(end - 1), of[MIN_Y] = (double)y;
  of[COUNT] += (double)count;
  of[SUM_X] += (double)sum, of[SUM_Y] += (double)(y * count);
  of[SUM_XX] += (double)(squares_below(end) - squares_below(first));
  of[SUM_XY] += (double)(sum * y), of[SUM_YY] += (double)(y * y * count);
  of[MIN_X] = (double)first < of[MIN_X] ? (double)first : of[MIN_X];
  of[MAX_X] = (double)(end - 1) > of[MAX_X] ? (double)(end - 1) : of[MAX_X];
  of[MAX_Y] = (double)y;
}

// The first pixel from x on that is of a region; whole words of pixels that are not are passed by.
static inline ptrdiff_t next_labeled(const uint16_t *row, ptrdiff_t x, ptrdiff_t w) {
  for (uint64_t word; x + 4 <= w; x += 4) {
    memcpy(&word, row + x, sizeof word);
    if (word != 0) break;
  }
  while (x < w && row[x] == 0) x++;
  return x;
}

// Labels are 1 ... n; 0 is no region. `moments` (n, FIGURES) is set, not added to.
EXPORT int region_moments(const uint16_t *labels, const float *depth, double *moments, ptrdiff_t h, ptrdiff_t w,
                          ptrdiff_t n) {
  memset(moments, 0, (size_t)n * FIGURES * sizeof *moments);
  for (ptrdiff_t y = 0; y < h; y++) {
    const uint16_t *row = labels + y * w;
    for (ptrdiff_t x = next_labeled(row, 0, w), end; x < w; x = next_labeled(row, end, w)) {
      if (row[x] > n) return WRONG_SIZE;
      for (end = x + 1; end < w && row[end] == row[x];) end++;
      take_in(moments + (row[x] - 1) * FIGURES, depth + y * w, x, end, y);
    }
  }
  return OK;
}

// The regions of a contact, their labels as of `label_regions` and their moments; how many.
EXPORT int contact_moments(const bool *contact, const float *depth, uint16_t *labels, double *moments, int32_t *work, ptrdiff_t h,
                           ptrdiff_t w, ptrdiff_t m, ptrdiff_t n) {
  const int regions = label_regions(contact, labels, work, h, w, n);
  if (regions < 0 || regions > UINT16_MAX) return regions;
  const int status = regions > m ? WRONG_SIZE : region_moments(labels, depth, moments, h, w, regions);
  return status == OK ? regions : status;
}

enum { AREA, DEPTH, X, Y, DEVIATION, EVIDENCE, OWN, MEASURES };

struct maps {
  const float *depth, *sigma, *evidence, *smooth, *bent, *influence;
  float stiffness, per_x, per_y;
  ptrdiff_t reach;  // of the influence, its number of values
};

// A run of a region's pixels in row y; `row` is that row's first pixel in the maps.
static void take_evidence(double *of, const struct maps *m, ptrdiff_t first, ptrdiff_t end, ptrdiff_t y, ptrdiff_t row) {
  for (ptrdiff_t x = first; x < end; x++) {
    const double z = m->depth[row + x], evidence = m->evidence[row + x];
    if (of[AREA] == 0 || z > of[DEPTH]) of[DEPTH] = z, of[X] = (double)x, of[Y] = (double)y, of[DEVIATION] = m->sigma[row + x];
    of[EVIDENCE] = evidence > of[EVIDENCE] ? evidence : of[EVIDENCE];
    of[AREA]++;
  }
}

static void take_own_depth(double *of, const struct maps *m, ptrdiff_t first, ptrdiff_t end, ptrdiff_t y, ptrdiff_t row) {
  const double dy = (double)y - of[Y], along_y = m->per_y * dy * dy;
  for (ptrdiff_t x = first; x < end; x++) {
    const double dx = (double)x - of[X], at = m->per_x * dx * dx + along_y;
    const double pressure = m->bent[row + x] + (double)m->stiffness * m->smooth[row + x];
    if (at < (double)m->reach) of[OWN] += (double)m->influence[(ptrdiff_t)at] * pressure;
  }
}

// Of each region 1 ... n: its pixels, depth and place of the deepest one, the depth's deviation there, the most
// evidence, and the depth that the region's own pressure makes at its deepest pixel. `smooth`, `bent`: the surface and minus its
// Laplacian. `influence`: depth for a unit of pressure at a pixel whose squared distance is the index; `per_x` and `per_y` are those
// of a step.
EXPORT int region_evidence(const uint16_t *labels, const float *depth, const float *sigma, const float *evidence, const float *smooth,
                           const float *bent, const float *influence, double *measures, float stiffness, float per_x, float per_y,
                           ptrdiff_t h, ptrdiff_t w, ptrdiff_t t, ptrdiff_t n) {
  const struct maps m = {depth, sigma, evidence, smooth, bent, influence, stiffness, per_x, per_y, t};
  memset(measures, 0, (size_t)(n * MEASURES) * sizeof *measures);
  for (int own = 0; own < 2; own++)
    for (ptrdiff_t y = 0; y < h; y++) {
      const uint16_t *row = labels + y * w;
      for (ptrdiff_t x = next_labeled(row, 0, w), end; x < w; x = next_labeled(row, end, w)) {
        if (row[x] > n) return WRONG_SIZE;
        for (end = x + 1; end < w && row[end] == row[x];) end++;
        (own ? take_own_depth : take_evidence)(measures + (row[x] - 1) * MEASURES, &m, x, end, y, y * w);
      }
    }
  return OK;
}

// The less of a region's deepest depth and of that which its own pressure makes there.
static inline double depth_of(const double *of) { return of[OWN] < of[DEPTH] ? of[OWN] : of[DEPTH]; }

// Whether each label 0 ... n is that of a region which stands, and its deepest pixel (y, x): of `least` pixels, and with more
// than `factor` deviations of pressure and of depth. A depth is over the gel around, which is off by as much, so the variance of the
// difference is twice its own; `excess` comes on top. `alone`: variance (r, c) of the deepest region, whose root is `most` at most; NULL:
// that of `measures`.
EXPORT int regions_that_stand(const double *measures, const float *alone, bool *stands, int32_t *deepest, double excess, double least,
                              float factor, float most, int64_t height, int64_t width, ptrdiff_t n, ptrdiff_t r, ptrdiff_t c,
                              ptrdiff_t m) {
  if (m != n + 1) return WRONG_SIZE;
  ptrdiff_t first = 0;
  for (ptrdiff_t k = 1; k < n; k++) first = depth_of(measures + k * MEASURES) > depth_of(measures + first * MEASURES) ? k : first;
  stands[0] = false, deepest[0] = deepest[1] = 0;
  for (ptrdiff_t k = 0; k < n; k++) {
    const double *of = measures + k * MEASURES;
    double variance = of[DEVIATION] * of[DEVIATION];
    if (k == first && alone != NULL) {
      const double own = at_pixel(alone, (ptrdiff_t)of[Y], (ptrdiff_t)of[X], r, c, height, width), limit = (double)most * most;
      variance = own < limit ? own : limit;
    }
    const double sigma = sqrt(2 * variance + excess), depth = depth_of(of) / (sigma > 1e-9 ? sigma : 1e-9), pressed = sqrt(of[EVIDENCE]);
    stands[k + 1] = of[AREA] >= least && (depth < pressed ? depth : pressed) > factor;
    deepest[2 * k + 2] = (int32_t)of[Y], deepest[2 * k + 3] = (int32_t)of[X];
  }
  return OK;
}

struct hill {
  const float *surface;
  ptrdiff_t reach, h, w;
};

// Mean of the surface over a square around a pixel.
static double height_at(const struct hill *o, ptrdiff_t y, ptrdiff_t x) {
  const ptrdiff_t top = y < o->reach ? 0 : y - o->reach, bottom = y + o->reach < o->h ? y + o->reach : o->h - 1;
  const ptrdiff_t left = x < o->reach ? 0 : x - o->reach, right = x + o->reach < o->w ? x + o->reach : o->w - 1;
  double total = 0;
  for (ptrdiff_t i = top; i <= bottom; i++)
    for (ptrdiff_t j = left; j <= right; j++) total += o->surface[i * o->w + j];
  return total / (double)((bottom - top + 1) * (right - left + 1));
}

// The highest of a pixel and its eight neighbors, of equal ones the first.
static ptrdiff_t way_up(const struct hill *o, ptrdiff_t at) {
  const ptrdiff_t y = at / o->w, x = at % o->w;
  ptrdiff_t highest = at;
  double most = height_at(o, y, x);
  for (ptrdiff_t i = y - (y > 0); i <= y + (y < o->h - 1); i++)
    for (ptrdiff_t j = x - (x > 0); j <= x + (x < o->w - 1); j++) {
      const double height = height_at(o, i, j);
      if (height > most) most = height, highest = i * o->w + j;
    }
  return highest;
}

// Climbs from a pixel of a region to the top of its hill. Where another region that stands is on the way, the way to it joins both.
static void join_uphill(const uint16_t *labels, const bool *stands, ptrdiff_t from, const struct hill *o, uint8_t *contact) {
  ptrdiff_t at = from, before = -1;
  while (at != before && (labels[at] == labels[from] || !stands[labels[at]])) before = at, at = way_up(o, at);
  if (at == before) return;
  for (ptrdiff_t step = from; step != at; step = way_up(o, step)) contact[step] = 1;
}

// The pixels of the regions that stand, of labels 0 ... n - 1, joined up the hills of a surface, averaged over squares, from their
// `deepest` pixels, (y, x).
EXPORT int standing_regions(const uint16_t *labels, const bool *stands, const int32_t *deepest, const float *surface, bool *contact,
                            int64_t reach, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  const struct hill o = {surface, reach, h, w};
  memset(contact, 0, (size_t)(h * w));
  for (ptrdiff_t y = 0; y < h; y++) {
    const uint16_t *row = labels + y * w;
    for (ptrdiff_t x = next_labeled(row, 0, w), end; x < w; x = next_labeled(row, end, w)) {
      if (row[x] >= n) return WRONG_SIZE;
      for (end = x + 1; end < w && row[end] == row[x];) end++;
      memset(contact + y * w + x, stands[row[x]], (size_t)(end - x));
    }
  }
  for (ptrdiff_t k = 1; k < n; k++) {
    const ptrdiff_t y = deepest[2 * k], x = deepest[2 * k + 1];
    if (y < 0 || y >= h || x < 0 || x >= w) return WRONG_SIZE;
    if (stands[k]) join_uphill(labels, stands, y * w + x, &o, (uint8_t *)contact);
  }
  return OK;
}

// The contact, of the regions that `pressed_regions` finds and of which some stand; arguments as of the steps. `sigmas`: deviations of
// the depth, by which regions stand, and outlines are drawn. They are made of the first two `variances`, and the third is that of the deepest
// region alone; NULL: they are given. How many regions there were; where they are more than have labels, nothing is written.
EXPORT int contact_mask(const float *depth, const float *variances, const bool *lost, float *sigmas, const float *noise, const float *read,
                        const float *solved, const bool *at_rest, const bool *known, const float *taps, const double *gains,
                        const float *influence, bool *contact, float *work, double least, float most, float along_x, float along_y,
                        float stiffness, float factor, float reach, int64_t margin, int64_t join, int64_t step, ptrdiff_t h, ptrdiff_t w,
                        ptrdiff_t r, ptrdiff_t c, ptrdiff_t t, ptrdiff_t u, ptrdiff_t n) {
  const ptrdiff_t count = h * w, left = n - 3 * count - (count + 1) / 2;
  const float *alone = variances == NULL ? NULL : variances + 2 * r * c;
  if (left < 0) return WRONG_SIZE;
  float *smooth = work + left, *bent = smooth + count, *evidence = bent + count;
  uint16_t *labels = (uint16_t *)(evidence + count);
  for (ptrdiff_t map = 0; map < 2 && variances != NULL; map++)
    if (root_at_pixels(variances + map * r * c, lost, work, sigmas + map * count, most, r, c, h, w, left) != OK) return WRONG_SIZE;
  const int regions = pressed_regions(depth, sigmas + count, noise, read, solved, at_rest, known, taps, gains, smooth, bent, evidence,
                                      labels, work, along_x, along_y, stiffness, factor, reach, margin, step, h, w, t, left);
  if (regions < 0 || regions > UINT16_MAX) return regions;
  // What regions were found with is free for what is measured of them.
  double *measures = (double *)work, excess;
  int32_t *deepest = (int32_t *)(measures + MEASURES * regions);
  bool *stands = (bool *)(deepest + 2 * (regions + 1));
  if ((char *)(stands + regions + 1) > (char *)(work + left)) return WRONG_SIZE;
  const float per_x = sqrtf(along_y / along_x);  // squared distance of neighbors, for a pixel of area 1
  if (region_evidence(labels, depth, sigmas, evidence, smooth, bent, influence, measures, stiffness, per_x, 1 / per_x, h, w, u,
                      regions) != OK ||
      variance_below(depth, sigmas, &excess, step, count) != OK ||
      regions_that_stand(measures, alone, stands, deepest, excess, least, factor, most, h, w, regions, r, c, regions + 1) != OK ||
      standing_regions(labels, stands, deepest, depth, contact, join, h, w, regions + 1) != OK)
    return WRONG_SIZE;
  return regions;
}
