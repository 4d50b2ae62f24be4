// The equations of a rigid motion: what a small further motion changes at each point of a contact, and their normal equations.
#include "../common.h"

enum { UNKNOWNS = 6, ROWS = 3, PADDED = 8 };

// The maps of the frame that the points moved into: slopes, depth, the slopes' derivatives, variances; touched, and not at its border.
struct maps {
  const float *gradients, *depth, *along_x, *along_y, *variances;
  const bool *contact, *inner;
  ptrdiff_t h, w;
};

struct sample {
  float gradients[2], depth, derivatives[4], variances[3];
  bool inner;
};

static inline float mixed(const float *map, ptrdiff_t stride, ptrdiff_t at, ptrdiff_t w, const float share[4]) {
  return share[0] * map[at * stride] + share[1] * map[(at + 1) * stride] + share[2] * map[(at + w) * stride] +
         share[3] * map[(at + w + 1) * stride];
}

// The maps at a place in px, between four pixels that all touch; false where one does not, or lies outside.
static bool sampled(const struct maps *m, float x, float y, struct sample *out) {
  if (!(x >= 0 && y >= 0 && x <= (float)(m->w - 1) && y <= (float)(m->h - 1))) return false;
  const ptrdiff_t column = x < (float)(m->w - 1) ? (ptrdiff_t)x : m->w - 2, row = y < (float)(m->h - 1) ? (ptrdiff_t)y : m->h - 2;
  const float a = x - (float)column, b = y - (float)row;
  const float share[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
  const ptrdiff_t at = row * m->w + column;
  const float touched = share[0] * m->contact[at] + share[1] * m->contact[at + 1] + share[2] * m->contact[at + m->w] +
                        share[3] * m->contact[at + m->w + 1];
  if (touched <= 0.5f) return false;
  for (int k = 0; k < 2; k++) out->gradients[k] = mixed(m->gradients + k, 2, at, m->w, share);
  for (int k = 0; k < 3; k++) out->variances[k] = mixed(m->variances + k, 3, at, m->w, share);
  for (int k = 0; k < 2; k++) {
    out->derivatives[k] = mixed(m->along_x + k, 2, at, m->w, share);
    out->derivatives[2 + k] = mixed(m->along_y + k, 2, at, m->w, share);
  }
  out->inner = m->inner[(row + (b >= 0.5f)) * m->w + column + (a >= 0.5f)];
  out->depth = mixed(m->depth, 1, at, m->w, share);
  return true;
}

// Three rows (slope along x, along y, depth) of a point at q, whose normal is now n, not of unit length: residuals, and how a
// shift by v and a turn by w about the center change them. d = q - center.
static void rows_of(const struct sample *s, const float q[3], const float n[3], const float d[3], float residual[ROWS],
                    float jacobian[ROWS * UNKNOWNS]) {
  const float *g = s->gradients, *change = s->derivatives, moved[3][UNKNOWNS] = {
      {1, 0, 0, 0, d[2], -d[1]}, {0, 1, 0, -d[2], 0, d[0]}, {0, 0, 1, d[1], -d[0], 0}};
  const float turned[3][3] = {{0, n[2], -n[1]}, {-n[2], 0, n[0]}, {n[1], -n[0], 0}};
  for (int i = 0; i < 2; i++) {
    const float slope = -n[i] / n[2];
    residual[i] = g[i] - slope;
    for (int k = 0; k < UNKNOWNS; k++) jacobian[i * UNKNOWNS + k] = change[i] * moved[0][k] + change[2 + i] * moved[1][k];
    for (int k = 0; k < 3; k++) jacobian[i * UNKNOWNS + 3 + k] += (turned[i][k] + slope * turned[2][k]) / n[2];
  }
  residual[2] = s->depth - q[2];
  for (int k = 0; k < UNKNOWNS; k++) jacobian[2 * UNKNOWNS + k] = g[0] * moved[0][k] + g[1] * moved[1][k] - moved[2][k];
}

// H (6, 6) and its right side (6) in the last column, in doubles and in the points' order.
static void add_up(const float *residual, const float *jacobian, const float *weight, ptrdiff_t n, double *normal) {
  double total[UNKNOWNS][PADDED] = {{0}}, row[PADDED] = {0};
  for (ptrdiff_t i = 0; i < n * ROWS; i++) {
    if (weight[i] == 0) continue;
    for (int j = 0; j < UNKNOWNS; j++) row[j] = jacobian[i * UNKNOWNS + j];
    row[UNKNOWNS] = -residual[i];
    for (int j = 0; j < UNKNOWNS; j++) {
      const double weighted = (double)weight[i] * row[j];
      for (int k = 0; k < PADDED; k++) total[j][k] += weighted * row[k];
    }
  }
  for (int j = 0; j < UNKNOWNS; j++) memcpy(normal + j * (UNKNOWNS + 1), total[j], (UNKNOWNS + 1) * sizeof(double));
}

// `points` (x, y, z) mm from the image's middle, with their slopes and variances (of the slopes, of the depth); `pose`: rows of the
// matrix (3, 4) that moves them. `origin` (x, y): px in the maps that is 0 mm. A point outside the other contact, or turned away,
// has weight 0. `huber`: in root mean squares of all weighted residuals; larger ones weigh less. `inside`: whether a point lies in
// the inner part. Returns the number of points with a weight.
EXPORT int motion_rows(const float *points, const float *slopes, const float *variance, const float *gradients, const float *depth,
                       const float *along_x, const float *along_y, const float *variances, const bool *contact,
                       const bool *inner, const double *pose, const double *center, const double *pitch, const double *origin, float huber,
                       float *residual, float *jacobian, float *weight, bool *inside, double *normal, ptrdiff_t n, ptrdiff_t h, ptrdiff_t w) {
  if (h < 2 || w < 2) return WRONG_SIZE;
  const struct maps maps = {gradients, depth, along_x, along_y, variances, contact, inner, h, w};
  memset(residual, 0, n * ROWS * sizeof(float)), memset(weight, 0, n * ROWS * sizeof(float));
  memset(jacobian, 0, n * ROWS * UNKNOWNS * sizeof(float));
  memset(inside, 0, n * sizeof(bool));
  double squares = 0;
  int shared = 0;
  for (ptrdiff_t i = 0; i < n; i++) {
    const float *p = points + 3 * i, before[3] = {-slopes[2 * i], -slopes[2 * i + 1], 1};
    float q[3], normal_of[3], away[3];
    for (int k = 0; k < 3; k++) {
      const double *row = pose + 4 * k;
      q[k] = (float)(row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]);
      normal_of[k] = (float)(row[0] * before[0] + row[1] * before[1] + row[2] * before[2]);
      away[k] = (float)(q[k] - center[k]);
    }
    const float length = normal_of[0] * normal_of[0] + normal_of[1] * normal_of[1] + normal_of[2] * normal_of[2];
    if (!(normal_of[2] > 0.2f * sqrtf(length))) continue;  // turned out of sight
    const float x = (float)(q[0] / pitch[0] + origin[0]), y = (float)(q[1] / pitch[1] + origin[1]);
    struct sample s;
    if (!sampled(&maps, x, y, &s)) continue;
    shared++;
    inside[i] = s.inner;
    rows_of(&s, q, normal_of, away, residual + ROWS * i, jacobian + ROWS * UNKNOWNS * i);
    for (int k = 0; k < ROWS; k++) {
      const float r = residual[ROWS * i + k], both = 1 / (variance[3 * i + k] + s.variances[k]);
      weight[ROWS * i + k] = both;
      squares += (double)both * r * r;
    }
  }
  const float most = huber * sqrtf((float)(squares / (ROWS * (shared > 0 ? shared : 1))));
  for (ptrdiff_t i = 0; i < n * ROWS; i++) {
    const float off = sqrtf(weight[i]) * fabsf(residual[i]);
    weight[i] *= off > most ? most / off : 1;
  }
  add_up(residual, jacobian, weight, n, normal);
  return shared;
}
