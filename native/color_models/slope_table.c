// A table of color over slope and place, and its inverse: a coarse search, then Gauss-Newton steps.
#include "../common.h"

enum { CHANNELS = 3, TERMS = 6, STEPS = 8, HALVINGS = 4, MAX_STARTS = 512 };
static const float PI = 3.14159265358979f, NUDGE = 0.01f;

// values: (angles, directions, CHANNELS, TERMS); the last direction is the first again.
struct table {
  const float *values;
  ptrdiff_t angles, directions;
};

struct place {
  float u, v;
};

struct slope {
  float p, q;
};

// Arc tangent of 0 <= x <= 1 within 1e-7: a polynomial, since atanf differs between platforms (Abramowitz and Stegun,
// Handbook of Mathematical Functions, 1964, eq. 4.4.49).
static float atan_of_fraction(float x) {
  static const float c[] = {0.0028662257f, -0.0161657367f, 0.0429096138f, -0.0752896400f, 0.1065626393f,
                            -0.1420889944f, 0.1999355085f, -0.3333314528f, 1.0f};
  float sum = 0;
  for (int k = 0; k < 9; k++) sum = sum * (x * x) + c[k];
  return sum * x;
}

static float atan_positive(float x) { return x <= 1 ? atan_of_fraction(x) : PI / 2 - atan_of_fraction(1 / x); }

// Angle of (x, y), -pi to pi; 0 at the origin.
static float direction_of(float y, float x) {
  const float across = fabsf(y), along = fabsf(x);
  if (across == 0 && along == 0) return 0;
  const float angle = across <= along ? atan_of_fraction(across / along) : PI / 2 - atan_of_fraction(along / across);
  const float turned = x < 0 ? PI - angle : angle;
  return y < 0 ? -turned : turned;
}

static float quadratic(const float *row, struct place at) {
  return (row[0] * at.u + row[2] * at.v + row[3]) * at.u + (row[1] * at.v + row[4]) * at.v + row[5];
}

// Color change at a slope and a place, bilinear between the bins of angle and direction.
static void color_of(const struct table *table, struct slope slope, struct place at, float color[CHANNELS]) {
  const ptrdiff_t around = table->directions - 1, bin = CHANNELS * TERMS;
  const float angles = (float)table->angles;
  const float steep = atan_positive(sqrtf(slope.p * slope.p + slope.q * slope.q)) * ((angles - 1) / (PI / 2));
  const float i = clamp(steep, 0, angles - 1.001f);
  const float turn = clamp(direction_of(slope.q, slope.p), -PI, PI);  // NaN becomes -PI
  const float j = (turn + PI) * ((float)around / (2 * PI)) - 0.5f;
  const ptrdiff_t row = (ptrdiff_t)i, below = (ptrdiff_t)floorf(j);
  const float s = i - (float)row, t = j - (float)below;
  const float *near = table->values + row * table->directions * bin, *far = near + table->directions * bin;
  const ptrdiff_t one = ((below + around) % around) * bin, other = ((below + 1) % around) * bin;
  for (int c = 0; c < CHANNELS; c++) {
    float a = quadratic(near + one + c * TERMS, at), b = quadratic(far + one + c * TERMS, at);
    a += t * (quadratic(near + other + c * TERMS, at) - a);
    b += t * (quadratic(far + other + c * TERMS, at) - b);
    color[c] = a + s * (b - a);
  }
}

static float distance_of(const float color[CHANNELS], const float *change) {
  float sum = 0;
  for (int c = 0; c < CHANNELS; c++) sum += (color[c] - change[c]) * (color[c] - change[c]);
  return sum;
}

// The Gauss-Newton step in double, slightly damped where the colors do not tell a direction.
static struct slope step_from(const struct table *table, struct slope slope, struct place at, const float here[CHANNELS],
                              const float *change) {
  float right[CHANNELS], down[CHANNELS];
  color_of(table, (struct slope){slope.p + NUDGE, slope.q}, at, right);
  color_of(table, (struct slope){slope.p, slope.q + NUDGE}, at, down);
  double a = 0, b = 0, c = 0, d = 0, e = 0;
  for (int n = 0; n < CHANNELS; n++) {
    const double by_p = (right[n] - here[n]) / NUDGE, by_q = (down[n] - here[n]) / NUDGE, missing = change[n] - here[n];
    a += by_p * by_p, b += by_p * by_q, c += by_q * by_q, d += by_p * missing, e += by_q * missing;
  }
  const double damping = 1e-3 * (a + c) + 1e-9;
  a += damping, c += damping;
  const double determinant = a * c - b * b;
  return (struct slope){(float)((c * d - b * e) / determinant), (float)((a * e - b * d) / determinant)};
}

// Steps, each halved until it improves; returns the squared distance that is left.
static float improve(const struct table *table, struct slope *slope, struct place at, const float *change) {
  float here[CHANNELS];
  color_of(table, *slope, at, here);
  float least = distance_of(here, change);
  for (int k = 0; k < STEPS && least > 0; k++) {
    struct slope step = step_from(table, *slope, at, here, change);
    bool better = false;
    for (int halving = 0; halving < HALVINGS && !better; halving++) {
      const struct slope tried = {slope->p + step.p, slope->q + step.q};
      float color[CHANNELS];
      color_of(table, tried, at, color);
      better = distance_of(color, change) < least;
      if (better) {
        *slope = tried;
        memcpy(here, color, sizeof here);
      }
      step.p /= 2, step.q /= 2;
    }
    if (!better) break;
    least = distance_of(here, change);
  }
  return least;
}

// Squared distances of the colors of all starts; terms: (CHANNELS, TERMS, starts).
static void search(const float *restrict terms, struct place at, const float *change, float *restrict distances,
                   ptrdiff_t starts) {
  memset(distances, 0, (size_t)starts * sizeof *distances);
  for (int c = 0; c < CHANNELS; c++) {
    const float *restrict row = terms + c * TERMS * starts;
    for (ptrdiff_t n = 0; n < starts; n++) {
      const float color = (row[n] * at.u + row[2 * starts + n] * at.v + row[3 * starts + n]) * at.u +
                          (row[starts + n] * at.v + row[4 * starts + n]) * at.v + row[5 * starts + n];
      distances[n] += (color - change[c]) * (color - change[c]);
    }
  }
}

// The nearest start, and the nearest of those that do not follow the nearest so far in the list.
static void two_nearest(const float *distances, ptrdiff_t starts, ptrdiff_t nearest[2]) {
  float least = INFINITY, next = INFINITY;
  nearest[0] = nearest[1] = 0;
  for (ptrdiff_t n = 0; n < starts; n++) {
    const bool apart = n > nearest[0] + 1;
    if (distances[n] < least) {
      if (apart) nearest[1] = nearest[0], next = least;
      nearest[0] = n, least = distances[n];
    } else if (apart && distances[n] < next) {
      nearest[1] = n, next = distances[n];
    }
  }
}

EXPORT int slope_table_color(const float *restrict values, const float *restrict u, const float *restrict v,
                             const float *restrict gradients, float *restrict change, ptrdiff_t angles,
                             ptrdiff_t directions, ptrdiff_t n) {
  const struct table table = {values, angles, directions};
  for (ptrdiff_t k = 0; k < n; k++)
    color_of(&table, (struct slope){gradients[2 * k], gradients[2 * k + 1]}, (struct place){u[k], v[k]}, change + 3 * k);
  return OK;
}

// For each pixel the two nearest of the starts, each improved; the better one.
EXPORT int slope_table_gradients(const float *restrict values, const float *restrict u, const float *restrict v,
                                 const float *restrict change, const float *restrict starts, const float *restrict terms,
                                 float *restrict gradients, ptrdiff_t angles, ptrdiff_t directions, ptrdiff_t n,
                                 ptrdiff_t count) {
  if (count > MAX_STARTS) return WRONG_SIZE;
  const struct table table = {values, angles, directions};
  float distances[MAX_STARTS];
  for (ptrdiff_t k = 0; k < n; k++) {
    const struct place at = {u[k], v[k]};
    ptrdiff_t nearest[2];
    search(terms, at, change + 3 * k, distances, count);
    two_nearest(distances, count, nearest);
    struct slope best = {starts[2 * nearest[0]], starts[2 * nearest[0] + 1]};
    const float least = improve(&table, &best, at, change + 3 * k);
    if (nearest[1] != nearest[0] && least > 0) {
      struct slope other = {starts[2 * nearest[1]], starts[2 * nearest[1] + 1]};
      if (improve(&table, &other, at, change + 3 * k) < least) best = other;
    }
    gradients[2 * k] = best.p, gradients[2 * k + 1] = best.q;
  }
  return OK;
}
