// Cast shadows: along the ray from a pixel to a light, the surface that stands steepest over the pixel hides most of it.
#include "../common.h"

struct ray {
  ptrdiff_t along, aside;  // a step on the surface, in samples: along the longer axis, and one across it
  float slope;             // rows across for each step along
  ptrdiff_t last;          // steps until it is over everything or leaves the surface
};

// The largest rise over run from a sample to the surface under its ray.
static float steepest(const float *from, const struct ray *ray) {
  float best = -INFINITY;
  for (ptrdiff_t step = 1; step <= ray->last; step++) {
    const float across = (float)step * ray->slope;
    const int32_t whole = (int32_t)across;
    const float *at = from + step * ray->along + whole * ray->aside;
    const float rise = at[0] + (across - (float)whole) * (at[ray->aside] - at[0]) - *from;
    best = larger(rise / (float)step, best);
  }
  return best;
}

static inline bool apart(double a, double b, ptrdiff_t low, ptrdiff_t high) {
  return (a < (double)low && b < (double)low) || (a > (double)high && b > (double)high);
}

// The part of a light seen from (i, j); `led` is its place (column, row in samples; mm) and its diameter in mm.
static float seen_from(const float *depth, ptrdiff_t i, ptrdiff_t j, const double *led, const ptrdiff_t *box, double top,
                       double sharpest, ptrdiff_t h, ptrdiff_t w) {
  const float *from = depth + i * w + j;
  const double dx = led[0] - (double)j, dy = led[1] - (double)i, ax = fabs(dx), ay = fabs(dy);
  const double steps = ax > ay ? ax : ay;
  const double rise = (led[2] - *from) / steps, soft = 0.5 * led[3] / steps + sharpest;
  if (steps < 1 || !(rise > 0)) return 1;
  const double reach = (top - *from) / rise + 1, last = floor(reach < steps ? reach : steps);
  if (apart((double)j, (double)j + last * dx / steps, box[2], box[3])) return 1;
  if (apart((double)i, (double)i + last * dy / steps, box[0], box[1])) return 1;
  const ptrdiff_t right = dx >= 0 ? 1 : -1, room_x = dx >= 0 ? w - 1 - j : j;
  const ptrdiff_t down = dy >= 0 ? w : -w, room_y = dy >= 0 ? h - 1 - i : i;
  struct ray ray = {right, down, (float)(ay / ax), room_x};
  if (ax < ay) ray = (struct ray){down, right, (float)(ax / ay), room_y};
  const double beside = (double)(ax < ay ? room_x : room_y) * (1 - 1e-6);  // steps across: one sample further is read
  if (beside < 0.5) return 1;
  if (beside <= (double)ray.last * ray.slope) ray.last = (ptrdiff_t)ceil(beside / ray.slope) - 1;
  if (last < (double)ray.last) ray.last = (ptrdiff_t)last;
  if (ray.last < 1) return 1;
  return clamp((float)(0.5 + 0.5 * (rise - steepest(from, &ray)) / soft), 0, 1);
}

// First and last row and column of what can hide a light; false: nothing. A ray that leaves the surface upwards is only
// stopped behind a cell, between four samples, where the surface rises faster than the ray, toward the light: as fast as
// its steepest edges at most, and a little more, because not all rays through a cell are parallel.
static bool can_hide(const float *depth, const double *led, float reach, float top, float sharpest, ptrdiff_t *box,
                     ptrdiff_t h, ptrdiff_t w) {
  const float x = (float)led[0] - 0.5f, y = (float)led[1] - 0.5f, over = (float)led[2] - top, size = 0.5f * (float)led[3];
  box[0] = h, box[1] = -1, box[2] = w, box[3] = -1;
  for (ptrdiff_t i = 0; i < h - 1; i++) {
    const float *a = depth + i * w, *b = a + w, dy = y - (float)i;
    int32_t first = (int32_t)w, last = -1;
    for (int32_t j = 0; j < (int32_t)w - 1; j++) {
      const float dx = x - (float)j, steps = larger(larger(fabsf(dx), fabsf(dy)), 3);
      const float x0 = a[j + 1] - a[j], x1 = b[j + 1] - b[j], y0 = b[j] - a[j], y1 = b[j + 1] - a[j + 1];
      const float edges = larger(fabsf(x0), fabsf(x1)) + larger(fabsf(y0), fabsf(y1));
      const float rise = (larger(x0 * dx, x1 * dx) + larger(y0 * dy, y1 * dy) + 2 * edges) / steps;
      const bool hides = rise > over / (steps + reach + 2) - size / (steps - 2) - sharpest;
      const int32_t from = hides ? j : (int32_t)w, to = hides ? j : -1;  // so that the loop becomes vectors
      first = from < first ? from : first, last = to > last ? to : last;
    }
    if (last < 0) continue;
    box[0] = i < box[0] ? i : box[0], box[1] = i + 1;
    box[2] = first < box[2] ? first : box[2], box[3] = last + 1 > box[3] ? last + 1 : box[3];
  }
  return box[1] >= 0;
}

// `reach`: how many samples a shadow can be long. How many lights something may hide; `seen` is 1 at first.
EXPORT int visible_lights(const float *depth, const double *leds, const int64_t *reach, float *seen, double top,
                          double sharpest, ptrdiff_t h, ptrdiff_t w, ptrdiff_t lights) {
  int hidden = 0;
  for (ptrdiff_t k = 0; k < lights; k++) {
    const double *led = leds + 4 * k;
    const ptrdiff_t far = (ptrdiff_t)reach[k];
    ptrdiff_t box[4];
    if (!can_hide(depth, led, (float)far, (float)top, (float)sharpest, box, h, w)) continue;
    hidden++;
    const ptrdiff_t i0 = box[0] - far, i1 = box[1] + far, j0 = box[2] - far, j1 = box[3] + far;
    for (ptrdiff_t i = i0 > 0 ? i0 : 0; i <= i1 && i < h; i++)
      for (ptrdiff_t j = j0 > 0 ? j0 : 0; j <= j1 && j < w; j++)
        seen[(k * h + i) * w + j] = seen_from(depth, i, j, led, box, top, sharpest, h, w);
  }
  return hidden;
}
