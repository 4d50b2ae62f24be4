// One Gauss-Newton step from slopes that were read to those whose color was seen, by the forward response: see
// slopes/color_models/forward_response.py. Value, Jacobian, step, covariance and residual of PIXELS pixels in one go.
#include "../../bilinear.h"
#include "nodes.h"

enum { CHANNELS = 3, TERMS = 17, COUNT = TERMS * CHANNELS, PLANES = 6 };
static const float ROUNDING = 1e-6f;  // of a determinant in float32, over the product of its diagonal

struct settings {
  const float *roots;  // (4, 3, 3): of the inverse covariance, lower triangular, of all channels and without each
  float at_rest, per_slope;  // variance of slopes that were read, and what the square of a slope adds to it
  float clipped_prior, longest;  // 1 over the variance of slopes read with a clipped channel; that deviation, of every step
};

// Coefficients (17, 3) at a block's first pixel, and how much more they are at the next node.
struct place {
  const float *first, *step;
};

struct pixels {
  lanes change[CHANNELS], p, q, z, prior;  // prior: 1 over the variance of p and of q
};

struct stepped {
  lanes p, q, variance, residual;
};

// A polynomial in x, and its derivative.
struct in_x {
  lanes value, slope;
};

static inline struct in_x linear(lanes x, lanes k1, lanes k0) { return (struct in_x){k1 * x + k0, k1}; }

static inline struct in_x then(struct in_x a, lanes x, lanes k) {
  return (struct in_x){a.value * x + k, a.slope * x + a.value};
}

// A polynomial in x and y, and its derivatives.
struct response {
  lanes value, per_x, per_y;
};

static inline struct response next_power(struct response r, lanes y, struct in_x a) {
  return (struct response){r.value * y + a.value, r.per_x * y + a.slope, r.per_y * y + r.value};
}

// Color change of one channel by the normal's terms x and y and the depth z. Coefficients are of x, y, xx, xy, yy, xxx, ...,
// yyyy, z, zx, zy. Horner's scheme, in x for each power of y and in y, from the highest power down: a quarter fewer products
// than monomials take, and nothing to keep but what registers hold.
static inline struct response response_of(const float *first, const float *step, lanes x, lanes y, lanes z) {
#define K(t) (first[(t) * CHANNELS] + along * step[(t) * CHANNELS])
  const lanes along = along_block();
  const lanes quartic = K(13);
  const struct in_x cubic = linear(x, K(12), K(8));
  struct response r = {quartic * y + cubic.value, cubic.slope, quartic};
  r = next_power(r, y, then(linear(x, K(11), K(7)), x, K(4)));
  r = next_power(r, y, then(then(linear(x, K(10), K(6)), x, K(3)), x, K(1) + z * K(16)));
  return next_power(r, y, then(then(then(linear(x, K(9), K(5)), x, K(2)), x, K(0) + z * K(15)), x, z * K(14)));
#undef K
}

static inline lanes square_root(lanes a) {
  for (int k = 0; k < LANES; k++) a[k] = sqrtf(a[k]);
  return a;
}

// The factor for a step of this squared length: 1 up to the longest.
static inline lanes shortening(lanes square, float longest) {
  lanes length = square_root(square);
  for (int k = 0; k < LANES; k++) length[k] = larger(length[k], longest);
  return longest / length;
}

// The root's transpose times the channels: their errors become independent and of variance 1.
static inline void whiten(lanes v[CHANNELS], const float *root) {
  v[0] = root[0] * v[0] + root[3] * v[1] + root[6] * v[2];
  v[1] = root[4] * v[1] + root[7] * v[2];
  v[2] *= root[8];
}

// One step, at most `longest`: a longer one would explain a mirrored light or dust by a slope of its color.
static struct stepped step_of(const struct pixels *at, struct place place, const float *root, float longest) {
  const lanes p = at->p, q = at->q, cosine = 1 / square_root(1 + p * p + q * q);
  const lanes cube = cosine * cosine * cosine, x = p * cosine, y = q * cosine;
  const lanes x_per_p = (1 + q * q) * cube, x_per_q = -p * q * cube, y_per_q = (1 + p * p) * cube;  // y_per_p is x_per_q
  lanes left[CHANNELS], per_p[CHANNELS], per_q[CHANNELS];
  for (int c = 0; c < CHANNELS; c++) {
    const struct response r = response_of(place.first + c, place.step + c, x, y, at->z);
    left[c] = at->change[c] - r.value;
    per_p[c] = r.per_x * x_per_p + r.per_y * x_per_q;
    per_q[c] = r.per_x * x_per_q + r.per_y * y_per_q;
  }
  whiten(left, root), whiten(per_p, root), whiten(per_q, root);
  lanes h11 = {0}, h12 = {0}, h22 = {0}, b1 = {0}, b2 = {0}, residual = {0};
  for (int c = 0; c < CHANNELS; c++) {
    h11 += per_p[c] * per_p[c], h12 += per_p[c] * per_q[c], h22 += per_q[c] * per_q[c];
    b1 += per_p[c] * left[c], b2 += per_q[c] * left[c];
  }
  h11 += at->prior, h22 += at->prior;
  const lanes per = 1 / (h11 * h22 * (1 + ROUNDING) - h12 * h12);  // not 0 where a color tells two slopes apart no more
  const lanes whole_u = (h22 * b1 - h12 * b2) * per, whole_v = (h11 * b2 - h12 * b1) * per;
  const lanes part = shortening(whole_u * whole_u + whole_v * whole_v, longest);
  const lanes u = whole_u * part, v = whole_v * part;
  for (int c = 0; c < CHANNELS; c++) {
    const lanes rest = left[c] - per_p[c] * u - per_q[c] * v;
    residual += rest * rest;
  }
  return (struct stepped){p + u, q + v, 0.5f * (h11 + h22) * per, residual};
}

// From a block's first pixel on.
struct outputs {
  float *gradients, *variance, *residual;
};

static inline void store(const struct stepped *s, struct outputs to, ptrdiff_t count) {
  if (count == PIXELS) {
    store_in_turn(to.gradients, s->p, s->q);
    store_lanes(to.variance, s->variance), store_lanes(to.residual, s->residual);
    return;
  }
  row_of_slopes((const float *)&s->p, (const float *)&s->q, to.gradients, count);
  memcpy(to.variance, &s->variance, (size_t)count * sizeof(float));
  memcpy(to.residual, &s->residual, (size_t)count * sizeof(float));
}

static inline bool any_clipped(const uint8_t *clipped, ptrdiff_t count) {
  uint8_t any = 0;
  for (ptrdiff_t k = 0; k < CHANNELS * count; k++) any |= clipped[k];
  return any != 0;
}

// Whether this channel of a pixel alone is clipped.
static inline bool is_clipped_alone(const uint8_t *clipped, int channel) {
  return clipped[channel] != 0 && clipped[(channel + 1) % CHANNELS] == 0 && clipped[(channel + 2) % CHANNELS] == 0;
}

// A block's pixels of one clipped channel again, in two steps by the other two; of more clipped channels nothing is known.
static void store_clipped(const struct pixels *at, struct place place, const struct settings *s, const uint8_t *clipped,
                          struct outputs to, ptrdiff_t count) {
  for (int channel = 0; channel < CHANNELS; channel++) {
    bool alone = false;
    for (ptrdiff_t k = 0; k < count; k++) alone |= is_clipped_alone(clipped + CHANNELS * k, channel);
    if (!alone) continue;
    const float *root = s->roots + CHANNELS * CHANNELS * (1 + channel);
    struct pixels again = *at;
    again.prior = (lanes){0} + s->clipped_prior;
    const struct stepped once = step_of(&again, place, root, s->longest);
    again.p = once.p, again.q = once.q;
    const struct stepped twice = step_of(&again, place, root, s->longest);
    for (ptrdiff_t k = 0; k < count; k++) {
      if (!is_clipped_alone(clipped + CHANNELS * k, channel)) continue;
      to.gradients[2 * k] = twice.p[k], to.gradients[2 * k + 1] = twice.q[k];
      to.variance[k] = twice.variance[k], to.residual[k] = twice.residual[k];
    }
  }
}

// Planes (6, stride): color change, slopes, depth. Coefficients of the row at its nodes.
static void step_row(const struct settings *s, const float *planes, ptrdiff_t stride, struct place place,
                     const uint8_t *clipped, struct outputs to, ptrdiff_t w) {
  for (ptrdiff_t start = 0; start < w; start += PIXELS) {
    const ptrdiff_t count = w - start < PIXELS ? w - start : PIXELS;
    const float *from = planes + start;
    const lanes p = load_lanes(from + 3 * stride), q = load_lanes(from + 4 * stride);
    const struct pixels at = {{load_lanes(from), load_lanes(from + stride), load_lanes(from + 2 * stride)}, p, q,
                              load_lanes(from + 5 * stride), 1 / (s->at_rest + s->per_slope * (p * p + q * q))};
    const struct stepped stepped = step_of(&at, place, s->roots, s->longest);
    store(&stepped, to, count);
    if (clipped != NULL && any_clipped(clipped + CHANNELS * start, count))
      store_clipped(&at, place, s, clipped + CHANNELS * start, to, count);
    place.first += COUNT, place.step += COUNT;
    to.gradients += 2 * PIXELS, to.variance += PIXELS, to.residual += PIXELS;
  }
}

static inline void planes_of_slopes(const float *restrict read, float *restrict p, float *restrict q, ptrdiff_t w) {
  for (ptrdiff_t x = 0; x < w; x++) p[x] = read[2 * x], q[x] = read[2 * x + 1];
}

static inline void plane_of_depth(struct rows_between *depths, ptrdiff_t y, double step, float *restrict z) {
  float fraction;
  hold_rows(depths, between(y, step, depths->rows, &fraction));
  const float *restrict upper = depths->upper, *restrict lower = depths->lower;
  for (ptrdiff_t x = 0; x < depths->n; x++) z[x] = upper[x] + fraction * (lower[x] - upper[x]);
}

EXPORT int forward_step(const float *change, const float *read, const float *depth, const uint8_t *clipped,
                        const float *nodes, const float *roots, float *work, float *gradients, float *variance,
                        float *residual, float at_rest, float per_slope, float clipped_prior,
                        ptrdiff_t h, ptrdiff_t w, ptrdiff_t dh, ptrdiff_t dw, ptrdiff_t r, ptrdiff_t c, ptrdiff_t n) {
  const ptrdiff_t stride = padded_width(w), own = 2 * c * COUNT + PLANES * stride;
  if (!nodes_fit(r, c, h, w) || dh < 1 || dw < 1 || n < own + 4 * w) return WRONG_SIZE;
  float *steps = work + c * COUNT, *planes = steps + c * COUNT, *lines = work + own;
  const struct settings s = {roots, at_rest, per_slope, clipped_prior, 1 / sqrtf(clipped_prior)};
  const struct node_grid grid = {nodes, r, c, COUNT, work, NULL};
  struct rows_between depths = {depth, dh, dw, w, -1, (int32_t *)lines, lines + w, lines + 2 * w, lines + 3 * w};
  places_in_row(w, (double)dw / (double)w, dw, (int32_t *)lines, lines + w);
  memset(planes, 0, sizeof(float) * PLANES * (size_t)stride);  // pixels beyond the last are stepped too, but not stored
  for (ptrdiff_t y = 0; y < h; y++) {
    const ptrdiff_t at = y * w;
    planes_of_row(change + CHANNELS * at, planes, w, stride);
    planes_of_slopes(read + 2 * at, planes + 3 * stride, planes + 4 * stride, w);
    plane_of_depth(&depths, y, (double)dh / (double)h, planes + 5 * stride);
    coefficients_of_row(&grid, y, 0, w);
    steps_of_row(&grid, steps);
    step_row(&s, planes, stride, (struct place){work, steps}, clipped == NULL ? NULL : clipped + CHANNELS * at,
             (struct outputs){gradients + 2 * at, variance + at, residual + at}, w);
  }
  return OK;
}
