// A light, exp(L(x, y)) B + r, fitted to blocks of an image by Gauss-Newton, with touched blocks as outliers.
#include "../../common.h"

enum { CHANNELS = 3, TERMS = 4 };  // a channel's gain, its tilts along x and y, its room light

struct lit_blocks {
  const float *image, *untouched;  // (h, w, 3)
  double *columns, *rows;          // (w, 3), (h, 3): factors of the light
  double *square;                  // (h, w): squared residuals, -1 of unlit blocks
  double wide, offset;             // deviation of a touched block; gray levels
  float dark, bright;
  ptrdiff_t h, w;
};

// What a light leaves: the normal matrices and right sides of the next step, unscaled; blocks at rest, their squares, lit blocks.
struct fit_sums {
  double normal[CHANNELS][TERMS][TERMS], side[CHANNELS][TERMS], at_rest, squares;
  int lit;
};

// The same bits on every platform.
static double exponential(double z) {
  static const double shares[] = {1, 1 / 2.0, 1 / 3.0, 1 / 4.0, 1 / 5.0, 1 / 6.0, 1 / 7.0, 1 / 8.0, 1 / 9.0, 1 / 10.0};
  const double limited = z < -700 ? -700 : z > 700 ? 700 : z, doublings = floor(limited / 0.6931471805599453 + 0.5);
  const double x = limited - doublings * 0.6931471805599453;
  const uint64_t bits = (uint64_t)((int64_t)doublings + 1023) << 52;
  double power = 1, scale;
  for (int k = 9; k >= 0; k--) power = 1 + x * power * shares[k];
  memcpy(&scale, &bits, sizeof scale);
  return power * scale;
}

// Of the middle of a block, from -1 to 1 between the borders.
static double place(ptrdiff_t k, ptrdiff_t n) { return (2.0 * k + 1) / n - 1; }

static bool is_lit(const struct lit_blocks *b, ptrdiff_t at) {
  for (int c = 0; c < CHANNELS; c++) {
    const float image = b->image[at + c], untouched = b->untouched[at + c];
    if (!(smaller(image, untouched) > b->dark && larger(image, untouched) < b->bright)) return false;
  }
  return true;
}

static inline void add_block(const struct lit_blocks *b, ptrdiff_t x, ptrdiff_t y, const double values[CHANNELS][TERMS],
                             double sigma, struct fit_sums *sums) {
  const double ratio = sigma / b->wide, odds = ratio * ratio * ratio, apart = 0.5 / (sigma * sigma) - 0.5 / (b->wide * b->wide);
  const double across = place(x, b->w), down = place(y, b->h);
  const ptrdiff_t at = 3 * (y * b->w + x);
  double residual[CHANNELS], terms[CHANNELS][TERMS], total = 0;
  for (int c = 0; c < CHANNELS; c++) {
    const double light = b->columns[3 * x + c] * b->rows[3 * y + c] * b->untouched[at + c];
    const double seen = light + values[c][3] + b->offset, per_level = 1 / (seen > 1 ? seen : 1), per_log = light * per_level;
    const double of_channel[TERMS] = {per_log, per_log * across, per_log * down, per_level};
    memcpy(terms[c], of_channel, sizeof of_channel);
    residual[c] = (b->image[at + c] + b->offset) * per_level - 1;
    total += residual[c] * residual[c];
  }
  const double odd = exponential(-total * apart), at_rest = odd / (odd + odds);
  b->square[y * b->w + x] = total;
  sums->at_rest += at_rest, sums->squares += at_rest * total, sums->lit++;
  for (int c = 0; c < CHANNELS; c++)
    for (int i = 0; i < TERMS; i++) {
      const double weighted = at_rest * terms[c][i];
      sums->side[c][i] += weighted * residual[c];
      for (int j = 0; j <= i; j++) sums->normal[c][i][j] += weighted * terms[c][j];
    }
}

static struct fit_sums sums_of(const struct lit_blocks *b, const double values[CHANNELS][TERMS], double sigma) {
  struct fit_sums sums = {0};
  for (int c = 0; c < CHANNELS; c++) {
    for (ptrdiff_t x = 0; x < b->w; x++) b->columns[3 * x + c] = exponential(values[c][0] + place(x, b->w) * values[c][1]);
    for (ptrdiff_t y = 0; y < b->h; y++) b->rows[3 * y + c] = exponential(place(y, b->h) * values[c][2]);
  }
  for (ptrdiff_t y = 0; y < b->h; y++)
    for (ptrdiff_t x = 0; x < b->w; x++) {
      b->square[y * b->w + x] = -1;
      if (is_lit(b, 3 * (y * b->w + x))) add_block(b, x, y, values, sigma, &sums);
    }
  return sums;
}

// Solves for one channel's step by Cholesky's factors; the prior makes the matrix positive definite.
static void solve(const double a[TERMS][TERMS], const double side[TERMS], double step[TERMS]) {
  double factor[TERMS][TERMS];
  for (int i = 0; i < TERMS; i++)
    for (int j = 0; j <= i; j++) {
      double left = a[i][j];
      for (int k = 0; k < j; k++) left -= factor[i][k] * factor[j][k];
      factor[i][j] = i == j ? sqrt(left) : left / factor[j][j];
    }
  for (int i = 0; i < TERMS; i++) {
    step[i] = side[i];
    for (int k = 0; k < i; k++) step[i] -= factor[i][k] * step[k];
    step[i] /= factor[i][i];
  }
  for (int i = TERMS - 1; i >= 0; i--) {
    for (int k = i + 1; k < TERMS; k++) step[i] -= factor[k][i] * step[k];
    step[i] /= factor[i][i];
  }
}

// `values` (3, 4), the light to begin with, are moved by a step in every round but the last, whose normal matrices and right sides
// are given back. `prior` holds each term's inverse variance, 0 of a term that is not fitted; `alike` is the number of independent
// blocks; `widened` the deviation at rest in each round, in units of `sigma`, or of the last round's if `learns`. `rest` receives
// the deviation at rest. Without `moves` the light stays.
EXPORT int fit_light(const float *image, const float *untouched, const double *prior, const double *widened, double *values,
                     double *normal, double *side, double *square, double *rest, double *work, double sigma, double least,
                     double wide, double alike, double offset, float dark, float bright, int32_t learns, int32_t moves,
                     ptrdiff_t h, ptrdiff_t w, ptrdiff_t rounds, ptrdiff_t n, ptrdiff_t m) {
  const struct lit_blocks b = {image, untouched, work, work + 3 * w, square, wide, offset, dark, bright, h, w};
  double(*light)[TERMS] = (double(*)[TERMS])values, (*matrices)[TERMS][TERMS] = (double(*)[TERMS][TERMS])normal;
  double(*sides)[TERMS] = (double(*)[TERMS])side;
  if (n != h * w || m < 3 * (h + w)) return WRONG_SIZE;
  for (ptrdiff_t round = 0; round < rounds; round++) {
    const double deviation = sigma * widened[round];
    const struct fit_sums found = sums_of(&b, (const double(*)[TERMS])light, deviation);
    const double weight = alike / ((found.lit > 0 ? found.lit : 1) * deviation * deviation);
    const double learnt = sqrt(found.squares / (CHANNELS * found.at_rest + 1e-9));
    for (int c = 0; c < CHANNELS; c++) {
      double step[TERMS];
      for (int i = 0; i < TERMS; i++) {
        for (int j = 0; j <= i; j++)
          matrices[c][i][j] = matrices[c][j][i] =
              (prior[i] > 0 && prior[j] > 0 ? weight * found.normal[c][i][j] : 0) + (i == j ? prior[i] > 0 ? prior[i] : 1 : 0);
        sides[c][i] = prior[i] > 0 ? weight * found.side[c][i] - prior[i] * light[c][i] : 0;
      }
      solve((const double(*)[TERMS])matrices[c], sides[c], step);
      for (int i = 0; i < TERMS && moves && round + 1 < rounds; i++) light[c][i] += step[i];
    }
    if (learns) sigma = learnt > least ? learnt : least;
    rest[0] = sigma;
  }
  return OK;
}
