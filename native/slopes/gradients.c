// Slopes of a depth map, their unit normals, and how far slopes are from those of a surface.
#include "../common.h"

// Difference per pixel at the first of n values, of second order where there are three.
static inline float one_sided(const float *z, ptrdiff_t step, ptrdiff_t n) {
  if (n < 2) return 0;
  return n == 2 ? z[step] - z[0] : 2 * (z[step] - z[0]) - 0.5f * (z[2 * step] - z[0]);
}

// Inner pixels of a row, from its own depths and those of the rows above and below.
static inline void inner_slopes(const float *above, const float *here, const float *below, float per_x, float per_y,
                                float *gradients, ptrdiff_t w) {
  ptrdiff_t x = 1;
  for (; x + LANES <= w - 1; x += LANES) {
    const lanes p = per_x * (load_lanes(here + x + 1) - load_lanes(here + x - 1));
    const lanes q = per_y * (load_lanes(below + x) - load_lanes(above + x));
    store_in_turn(gradients + 2 * x, p, q);
  }
  for (; x < w - 1; x++) {
    gradients[2 * x] = per_x * (here[x + 1] - here[x - 1]);
    gradients[2 * x + 1] = per_y * (below[x] - above[x]);
  }
}

// Central differences, one-sided at the border. `per_x`, `per_y`: pixels per unit of depth, 1 / mm_per_px.
EXPORT int slopes_of_depth(const float *depth, float *gradients, float per_x, float per_y, ptrdiff_t h, ptrdiff_t w) {
  for (ptrdiff_t y = 0; y < h; y++) {
    const float *here = depth + y * w, *above = y > 0 ? here - w : here, *below = y < h - 1 ? here + w : here;
    float *row = gradients + 2 * y * w, *end = row + 2 * (w - 1);
    inner_slopes(above, here, below, 0.5f * per_x, 0.5f * per_y, row, w);
    row[1] = 0.5f * per_y * (below[0] - above[0]);
    end[1] = 0.5f * per_y * (below[w - 1] - above[w - 1]);
    row[0] = per_x * one_sided(here, 1, w);
    end[0] = -per_x * one_sided(here + w - 1, -1, w);
  }
  float *first = gradients, *last = gradients + 2 * (h - 1) * w;
  for (ptrdiff_t x = 0; x < w; x++) {
    first[2 * x + 1] = per_y * one_sided(depth + x, w, h);
    last[2 * x + 1] = -per_y * one_sided(depth + (h - 1) * w + x, -w, h);
  }
  return OK;
}

// Squares of dp/dy - dq/dx of the known pixels of a row, by central differences, and how many they are.
static inline void curl_of_row(const float *restrict above, const float *restrict here, const float *restrict below,
                               const bool *restrict known, ptrdiff_t w, double *restrict total, ptrdiff_t *count) {
  float lanes[LANES] = {0};
  int32_t counted = 0;
  for (ptrdiff_t start = 1; start < w - 1; start += LANES) {
    const ptrdiff_t n = w - 1 - start < LANES ? w - 1 - start : LANES;
    for (ptrdiff_t k = 0; k < n; k++) {
      const ptrdiff_t x = start + k;
      const int32_t seen = known[x];
      const float curl = (below[2 * x] - above[2 * x]) - (here[2 * x + 3] - here[2 * x - 1]);
      lanes[k] += (float)seen * curl * curl;
      counted += seen;
    }
  }
  *total += 0.25f * lanes_total(lanes);
  *count += counted;
}

// The same where all pixels are known. p and q alternate in a row, and so do lanes that hold a curl and lanes that hold nothing
// of use, which are left out at the end: quicker than to part them first.
static inline void curl_of_whole_row(const float *above, const float *here, const float *below, ptrdiff_t w, double *restrict total,
                                     ptrdiff_t *count) {
  lanes squares = {0};
  ptrdiff_t i = 2;
  float rest = 0, kept = 0;
  for (; i + LANES <= 2 * (w - 1); i += LANES) {
    const lanes curl = (load_lanes(below + i) - load_lanes(above + i)) - (load_lanes(here + i + 3) - load_lanes(here + i - 1));
    squares += curl * curl;
  }
  for (; i < 2 * (w - 1); i += 2) {
    const float curl = (below[i] - above[i]) - (here[i + 3] - here[i - 1]);
    rest += curl * curl;
  }
  for (int k = 0; k < LANES; k += 2) kept += squares[k];
  *total += 0.25f * (kept + rest);
  *count += w > 2 ? w - 2 : 0;
}

// Their sum and number over frames: result (2). Without `known` all pixels count.
EXPORT int curl_squares(const float *gradients, const bool *known, double *result, ptrdiff_t n, ptrdiff_t h,
                        ptrdiff_t w) {
  double total = 0;
  ptrdiff_t count = 0;
  for (ptrdiff_t frame = 0; frame < n; frame++)
    for (ptrdiff_t y = 1; y < h - 1; y++) {
      const float *here = gradients + 2 * w * (frame * h + y);
      if (known == NULL) curl_of_whole_row(here - 2 * w, here, here + 2 * w, w, &total, &count);
      else curl_of_row(here - 2 * w, here, here + 2 * w, known + w * (frame * h + y), w, &total, &count);
    }
  result[0] = total;
  result[1] = (double)count;
  return OK;
}

// Unit normals (-p, -q, 1) / sqrt(1 + p^2 + q^2) of slopes.
EXPORT int normals_of_slopes(const float *restrict slopes, float *restrict normals, ptrdiff_t n) {
  for (ptrdiff_t k = 0; k < n; k++) {
    const float p = slopes[2 * k], q = slopes[2 * k + 1], length = sqrtf(p * p + q * q + 1);
    normals[3 * k] = -p / length;
    normals[3 * k + 1] = -q / length;
    normals[3 * k + 2] = 1 / length;
  }
  return OK;
}
