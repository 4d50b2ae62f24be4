// Strength of the anchor that holds gel at 0, from its coarse depth, spread over the frame's pixels.
#include "../../bilinear.h"
#include "../contact/runs.h"
#include "../../select.h"

int cell_means(const float *values, const bool *seen, float *work, float *cells, float *shares, ptrdiff_t h, ptrdiff_t w, ptrdiff_t c,
               ptrdiff_t n, ptrdiff_t r, ptrdiff_t k);
int distance_to_chosen(const bool *chosen, float *work, float *distance, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n);

// The share of pixels at rest in each cell; and the distance of each from those with a share under `least`, which are touched, or
// under the largest share; infinity where none is.
EXPORT int distance_from_touched(const bool *at_rest, float *work, float *share, float *distance, float least, ptrdiff_t h, ptrdiff_t w,
                                 ptrdiff_t n, ptrdiff_t r, ptrdiff_t k) {
  const ptrdiff_t size = r * k, of_mask = (size + 3) / 4;
  bool *touched = (bool *)work, any = false;
  if (n < of_mask + (r + 2) * (k + 2)) return WRONG_SIZE;
  const int status = cell_means(NULL, at_rest, work, NULL, share, h, w, 0, n, r, k);
  if (status != OK) return status;
  const float enough = smaller(least, range_of(share, size).high);
  for (ptrdiff_t i = 0; i < size; i++) touched[i] = share[i] < enough, any |= touched[i];
  for (ptrdiff_t i = 0; i < size && !any; i++) distance[i] = INFINITY;
  return any ? distance_to_chosen(touched, work + of_mask, distance, r, k, n - of_mask) : OK;
}

struct region {
  double depth;
  int32_t pixels, open;  // open: it reaches the border
};

// Sums over the regions of `at_rest`, each at its first run's place.
static void measure(struct run *runs, int32_t count, const float *depth, struct region *regions, ptrdiff_t h, ptrdiff_t w) {
  memset(regions, 0, (size_t)count * sizeof *regions);
  for (int32_t k = 0; k < count; k++) {
    const struct run *run = runs + k;
    struct region *region = regions + first_of(runs, k);
    for (ptrdiff_t x = run->from; x < run->to; x++) region->depth += depth[run->y * w + x];
    region->pixels += run->to - run->from;
    region->open |= run->y == 0 || run->y == h - 1 || run->from == 0 || run->to == w;
  }
}

// No hold in regions that touched gel encloses and that are off rest by more than `face` in the mean.
static void free_faces(const uint8_t *at_rest, const float *depth, float face, struct run *runs, struct region *regions, float *weight,
                       ptrdiff_t h, ptrdiff_t w) {
  const int32_t count = find_runs(at_rest, 1, EDGES, runs, h, w);
  measure(runs, count, depth, regions, h, w);
  for (int32_t k = 0; k < count; k++) {
    const struct region *region = regions + first_of(runs, k);
    if (region->open || fabs(region->depth) <= (double)face * region->pixels) continue;
    memset(weight + runs[k].y * w + runs[k].from, 0, (size_t)(runs[k].to - runs[k].from) * sizeof *weight);
  }
}

static ptrdiff_t most_runs(ptrdiff_t h, ptrdiff_t w) { return h * ((w + 1) / 2); }

enum { REGION_WORDS = sizeof(struct region) / sizeof(float) };

// For a coarse depth (h, w) and the fraction of untouched pixels in each of its pixels: `hold` times `far`, and nothing in faces.
// Rest is where the share is `least`, or as large as it gets.
static int rest_hold(const float *depth, const float *share, const float *far, float *work, float *weight, float hold, float least,
                     float face, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  const ptrdiff_t size = h * w, runs = most_runs(h, w);
  if (n < runs * (REGION_WORDS + RUN_WORDS) + 4 * size) return WRONG_SIZE;
  struct region *regions = (struct region *)work;
  float *z = work + runs * (REGION_WORDS + RUN_WORDS), *values = z + size;
  uint8_t *at_rest = (uint8_t *)(values + 2 * size);
  const float enough = smaller(least, range_of(share, size).high);
  ptrdiff_t count = 0;
  for (ptrdiff_t k = 0; k < size; k++) {
    at_rest[k] = share[k] >= enough;
    values[count] = depth[k];
    count += at_rest[k];
  }
  const float zero = median(values, count, (uint32_t *)(values + size));
  for (ptrdiff_t k = 0; k < size; k++) {
    z[k] = depth[k] - zero;
    weight[k] = hold * far[k];
  }
  free_faces(at_rest, z, face, (struct run *)(regions + runs), regions, weight, h, w);
  return OK;
}

// A coarse map >= 0 at the chosen pixels of a frame, bilinearly; 0 at the others. Whether a value is above 0.
static bool spread_over_chosen(const float *coarse, const bool *chosen, float *work, float *map, ptrdiff_t rows, ptrdiff_t columns,
                               ptrdiff_t h, ptrdiff_t w) {
  struct rows_between r = {coarse, rows, columns, w, -1, (int32_t *)work, work + w, work + 2 * w, work + 3 * w};
  float largest = 0;
  places_in_row(w, (double)columns / (double)w, columns, (int32_t *)work, work + w);
  for (ptrdiff_t i = 0; i < h; i++) {
    float fraction;
    hold_rows(&r, between(i, (double)rows / (double)h, rows, &fraction));
    const bool *restrict where = chosen + i * w;
    const float *restrict upper = r.upper, *restrict lower = r.lower;
    float *restrict row = map + i * w;
    for (ptrdiff_t j = 0; j < w; j++) row[j] = (float)where[j] * (upper[j] + fraction * (lower[j] - upper[j]));
    largest = larger(largest_magnitude(row, w), largest);
  }
  return largest > 0;
}

// Both: the anchor at every pixel, from maps of the cells. 1 if it holds a pixel, 0 if none.
EXPORT int rest_anchor(const float *depth, const float *share, const float *far, const bool *at_rest, float *work, float *anchor,
                       float hold, float least, float face, ptrdiff_t r, ptrdiff_t k, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  const ptrdiff_t left = n - r * k;
  float *weight = work + left;
  if (left < 4 * w) return WRONG_SIZE;
  const int status = rest_hold(depth, share, far, work, weight, hold, least, face, r, k, left);
  return status != OK ? status : spread_over_chosen(weight, at_rest, work, anchor, r, k, h, w);
}
