// What raises the standard deviation of a frame's slopes beyond the law: one pass, and the confidence that follows.
#include "../common.h"

enum { ROWS = 8, COLUMNS = LANES, TERMS = 9 };  // a cell of the forward response, and the monomials of two slopes
enum { PIECE = 4 * COLUMNS };                   // pixels of a row that are unpacked at a time

struct causes {
  const float *cells, *bias;
  float unexplained, sure, per_change, unseen, clean, added, per_bend, bend_from, per_slope, least;
  int32_t reach;
  uint8_t dark_to, saturated_from;
};

struct lines {
  float r[PIECE], g[PIECE], b[PIECE], p[PIECE], q[PIECE], variance[PIECE];
  float bend[2 * PIECE];
  int32_t sure[PIECE];
};

static inline void unpack(struct lines *restrict l, const float *restrict change, const float *restrict gradients,
                          const float *restrict bias, int n) {
  for (int k = 0; k < n; k++) l->r[k] = change[3 * k], l->g[k] = change[3 * k + 1], l->b[k] = change[3 * k + 2];
  for (int k = 0; k < n; k++) l->p[k] = gradients[2 * k] + bias[0], l->q[k] = gradients[2 * k + 1] + bias[1];
}

// Mean square of the channels of the color change minus that which the slopes explain, of a cell's pixels in a row.
static inline void find_unexplained(const float *restrict cell, struct lines *restrict l, int x) {
  const lanes p = load_lanes(l->p + x), q = load_lanes(l->q + x), pp = p * p, pq = p * q, qq = q * q;
  const lanes of[TERMS] = {p, q, pp, pq, qq, pp * p, pp * q, p * qq, qq * q};
  lanes r = load_lanes(l->r + x), g = load_lanes(l->g + x), b = load_lanes(l->b + x);
  for (int t = 0; t < TERMS; t++) r -= of[t] * cell[3 * t], g -= of[t] * cell[3 * t + 1], b -= of[t] * cell[3 * t + 2];
  store_lanes(l->variance + x, (r * r + g * g + b * b) * (1.0f / 3));
}

// Which pixels' colour no slope gives for sure; the others' variance grows with what is unexplained.
static inline void find_sure(const struct causes *c, struct lines *restrict l) {
  const float square = c->sure * c->sure, share = c->per_slope * c->per_slope;
  for (int k = 0; k < PIECE; k++)
    l->sure[k] = l->variance[k] > square + share * (l->p[k] * l->p[k] + l->q[k] * l->q[k]);
}

static inline int mark_sure(const struct lines *restrict l, bool *restrict marked, int n) {
  int count = 0;
  for (int k = 0; k < n; k++) count += l->sure[k];
  if (count > 0)
    for (int k = 0; k < n; k++) marked[k] |= l->sure[k] != 0;
  return count;
}

// Whether some square is that of more than a limit, or nearly: elsewhere no root need be taken.
static inline bool any_beyond(const float *restrict squares, float limit, int n) {
  const float from = 0.99999f * limit * limit;
  int count = 0;
  for (int k = 0; k < n; k++) count += squares[k] >= from;
  return count > 0;
}

static inline bool variance_of_unexplained(const struct causes *c, float *restrict variance, int n) {
  const bool some = any_beyond(variance, c->unexplained, n);
  if (!some) memset(variance, 0, (size_t)n * sizeof *variance);
  else
    for (int k = 0; k < n; k++) {
      const float sigma = c->per_change * larger(sqrtf(variance[k]) - c->unexplained, 0);
      variance[k] = sigma * sigma;
    }
  return some;
}

static inline float square_of(float x) { return x * x; }

static inline void add_squares(float *restrict sums, const float *restrict here, const float *restrict there, int first, int end) {
  for (int i = first; i < end; i++) sums[i] += square_of(there[i] - here[i]);
}

static inline void all_squares(float *restrict sums, const float *restrict at, ptrdiff_t across, ptrdiff_t down) {
  for (ptrdiff_t i = 0; i < 2 * PIECE; i++)
    sums[i] = ((square_of(at[i - across] - at[i]) + square_of(at[i + across] - at[i])) + square_of(at[i - down] - at[i])) + square_of(at[i + down] - at[i]);
}

// Squares of the differences of the slopes (p, q) from pixel x of row y on to those `reach` pixels away on four sides.
static inline void find_bend(const struct causes *c, struct lines *restrict l, const float *restrict gradients, ptrdiff_t x,
                             ptrdiff_t y, ptrdiff_t w, ptrdiff_t h, int n) {
  const ptrdiff_t reach = c->reach, left = reach - x, right = w - reach - x;
  const float *at = gradients + 2 * (y * w + x);
  if (n == PIECE && left <= 0 && right >= n && y >= reach && y < h - reach) {  // nearly everywhere
    all_squares(l->bend, at, 2 * reach, 2 * reach * w);
    return;
  }
  memset(l->bend, 0, sizeof l->bend);
  if (left < n) add_squares(l->bend, at, at - 2 * reach, 2 * (left > 0 ? (int)left : 0), 2 * n);
  if (right > 0) add_squares(l->bend, at, at + 2 * reach, 0, 2 * (right < n ? (int)right : n));
  if (y >= reach) add_squares(l->bend, at, at - 2 * reach * w, 0, 2 * n);
  if (y < h - reach) add_squares(l->bend, at, at + 2 * reach * w, 0, 2 * n);
}

// Variance of slopes that differ by more than `bend_from` from those around them.
static inline bool add_variance_of_bend(const struct causes *c, struct lines *restrict l) {
  float square[PIECE];
  for (int k = 0; k < PIECE; k++) square[k] = 0.5f * (l->bend[2 * k] + l->bend[2 * k + 1]);
  if (!any_beyond(square, c->bend_from, PIECE)) return false;
  for (int k = 0; k < PIECE; k++) {
    const float sigma = c->per_bend * larger(sqrtf(square[k]) - c->bend_from, 0);
    l->variance[k] += sigma * sigma;
  }
  return true;
}

// How many pixels have a channel at an end of the range; only these are marked in `clipped`.
static inline int find_clipped(const struct causes *c, const uint8_t *restrict image, bool *restrict clipped, int n) {
  int count = 0;
  uint8_t least = 255, most = 0;
  for (int i = 0; i < 3 * n; i++) least = image[i] < least ? image[i] : least, most = image[i] > most ? image[i] : most;
  memset(clipped, 0, (size_t)n * sizeof *clipped);
  if (least > c->dark_to && most < c->saturated_from) return 0;  // as nearly everywhere
  for (int k = 0; k < n; k++) {
    const uint8_t r = image[3 * k], g = image[3 * k + 1], b = image[3 * k + 2];
    const uint8_t low = r < g ? (r < b ? r : b) : (g < b ? g : b), high = r > g ? (r > b ? r : b) : (g > b ? g : b);
    clipped[k] = (low <= c->dark_to) | (high >= c->saturated_from);
    count += clipped[k];
  }
  return count;
}

// Where nothing is added the deviation stays as it is.
static inline void finish_unraised(const struct causes *c, const float *restrict sigma, float *restrict confidence, int n) {
  for (int k = 0; k < n; k++) {
    const float total = sigma[k] * sigma[k];
    confidence[k] = smaller(larger(c->clean * c->clean / total, total < c->unseen * c->unseen ? c->least : 0), 1);
  }
}

static inline void finish(const struct causes *c, const float *restrict variance, const float *restrict gain,
                          float *restrict sigma, float *restrict confidence, int n) {
  for (int k = 0; k < n; k++) {
    const float noise = c->added * gain[k], total = sigma[k] * sigma[k] + variance[k] + noise * noise;
    sigma[k] = sqrtf(total);
    confidence[k] = smaller(larger(c->clean * c->clean / total, total < c->unseen * c->unseen ? c->least : 0), 1);
  }
}

// Pixels at the camera's ends, and those whose colour no slope gives for sure, are marked in `marked`; how far they reach is
// known afterwards. Returns how many.
EXPORT int raise_sigma(const uint8_t *image, const float *change, const float *gradients, const bool *unseen_at,
                       const float *cells, const float *bias, const float *gain, float *sigma, float *confidence,
                       bool *marked, float unexplained, float sure, float per_change, float unseen, float clean, float added,
                       float per_bend, float bend_from, float per_slope, float least, int32_t reach,
                       int32_t dark_to, int32_t saturated_from, ptrdiff_t h, ptrdiff_t w, ptrdiff_t ch, ptrdiff_t cw) {
  const struct causes c = {cells, bias, unexplained, sure, per_change, unseen, clean, added, per_bend, bend_from, per_slope, least, reach, (uint8_t)dark_to, (uint8_t)saturated_from};
  const float square = unseen * unseen;
  int count = 0;
  if (cells != NULL && (ch != (h + ROWS - 1) / ROWS || cw != (w + COLUMNS - 1) / COLUMNS)) return WRONG_SIZE;
  struct lines l = {0};
  for (ptrdiff_t y = 0; y < h; y++)
    for (ptrdiff_t x = 0; x < w; x += PIECE) {
      const ptrdiff_t at = y * w + x;
      const int n = w - x < PIECE ? (int)(w - x) : PIECE;
      bool raised = added > 0 || unseen_at != NULL;
      if (cells != NULL) {
        const float *cell = cells + (y / ROWS * cw + x / COLUMNS) * TERMS * 3;
        unpack(&l, change + 3 * at, gradients + 2 * at, bias, n);
        for (int k = 0; k < n; k += COLUMNS, cell += TERMS * 3) find_unexplained(cell, &l, k);
        find_sure(&c, &l);
        raised |= variance_of_unexplained(&c, l.variance, PIECE);
      } else memset(l.variance, 0, sizeof l.variance);
      if (per_bend > 0) {
        find_bend(&c, &l, gradients, x, y, w, h, n);
        raised |= add_variance_of_bend(&c, &l);
      }
      if (unseen_at != NULL)
        for (int k = 0; k < n; k++) l.variance[k] += unseen_at[at + k] ? square : 0;
      count += find_clipped(&c, image + 3 * at, marked + at, n);
      if (cells != NULL) count += mark_sure(&l, marked + at, n);
      if (raised) finish(&c, l.variance, gain + at, sigma + at, confidence + at, n);
      else finish_unraised(&c, sigma + at, confidence + at, n);
    }
  return count;
}
