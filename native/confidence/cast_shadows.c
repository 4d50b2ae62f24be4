// Cast shadows, looked for in blocks of pixels: how dark they are, whether a hill stands in their light, and what the slopes
// change by then.
#include "../bilinear.h"
#include "../select.h"

enum { SIDE = 4, TERMS = 9, LIGHTS = 3, CHANNELS = 5 };  // px of a block; monomials of two slopes; channels and slopes
enum { STEPS = 31, REACH = 15 };                         // blocks along a ray; blocks on each side whose highest counts

// Adds a row of pixels' values to those of the rows above it.
static inline void add_row(const float *restrict row, float *restrict sums, ptrdiff_t n, bool first) {
  if (first) memcpy(sums, row, (size_t)n * sizeof *sums);
  else for (ptrdiff_t i = 0; i < n; i++) sums[i] += row[i];
}

// Each value and that `apart` further on; what is read beyond the last is 0.
static inline void add_ahead(float *restrict values, ptrdiff_t n, ptrdiff_t apart) {
  INDEPENDENT
  for (ptrdiff_t i = 0; i < n; i++) values[i] += values[i + apart];
}

// Means over the blocks of a row of blocks, one line for each of the `per` values of a pixel; the sums are used up.
static void means_of_blocks(float *sums, float *means, ptrdiff_t per, ptrdiff_t high, ptrdiff_t w, ptrdiff_t columns) {
  memset(sums + per * w, 0, (size_t)(SIDE * per) * sizeof *sums);
  add_ahead(sums, per * (w + 2), per);
  add_ahead(sums, per * w, 2 * per);
  for (ptrdiff_t j = 0; j < columns; j++) {
    const ptrdiff_t wide = w - SIDE * j < SIDE ? w - SIDE * j : SIDE;
    const float share = 1.0f / (float)(high * wide);
    for (ptrdiff_t k = 0; k < per; k++) means[k * columns + j] = share * sums[SIDE * j * per + k];
  }
}

// `table`: what each monomial of the slopes explains, then what the channels count.
static inline void darkness_of_row(const float *restrict m, const float *restrict table, float *restrict dark, ptrdiff_t n) {
  const float *restrict r = m, *restrict g = m + n, *restrict b = m + 2 * n, *restrict p = m + 3 * n, *restrict q = m + 4 * n;
  for (ptrdiff_t j = 0; j < n; j++) {
    const float pp = p[j] * p[j], pq = p[j] * q[j], qq = q[j] * q[j];
    const float of[TERMS] = {p[j], q[j], pp, pq, qq, pp * p[j], pp * q[j], p[j] * qq, qq * q[j]};
    float explained = of[0] * table[j];
    for (ptrdiff_t t = 1; t < TERMS; t++) explained += of[t] * table[t * n + j];
    dark[j] = explained - (r[j] * table[TERMS * n + j] + g[j] * table[(TERMS + 1) * n + j] + b[j] * table[(TERMS + 2) * n + j]);
  }
}

// Mean slopes of blocks, with a bias, and how much darker they are than these make them; 0 where a pixel shows no gel.
EXPORT int shadow_darkness(const float *change, const float *gradients, const bool *unseen, const float *table, const float *bias,
                           float *slopes, float *dark, float *work, ptrdiff_t h, ptrdiff_t w, ptrdiff_t rows,
                           ptrdiff_t columns, ptrdiff_t n) {
  float *colors = work, *slants = work + 3 * (w + SIDE), *means = work + CHANNELS * (w + SIDE);
  if (rows != (h + SIDE - 1) / SIDE || columns != (w + SIDE - 1) / SIDE) return WRONG_SIZE;
  if (n < CHANNELS * (w + SIDE + columns)) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < rows; i++) {
    const ptrdiff_t end = SIDE * (i + 1) < h ? SIDE * (i + 1) : h;
    for (ptrdiff_t y = SIDE * i; y < end; y++) {
      add_row(change + 3 * y * w, colors, 3 * w, y == SIDE * i);
      add_row(gradients + 2 * y * w, slants, 2 * w, y == SIDE * i);
    }
    float *p = means + 3 * columns, *q = means + 4 * columns;
    means_of_blocks(colors, means, 3, end - SIDE * i, w, columns);
    means_of_blocks(slants, p, 2, end - SIDE * i, w, columns);
    for (ptrdiff_t j = 0; j < columns; j++) p[j] += bias[0], q[j] += bias[1];
    for (ptrdiff_t j = 0; j < columns; j++) slopes[2 * (i * columns + j)] = p[j], slopes[2 * (i * columns + j) + 1] = q[j];
    darkness_of_row(means, table + i * (TERMS + 3) * columns, dark + i * columns, columns);
    for (ptrdiff_t y = SIDE * i; unseen != NULL && y < end; y++)
      for (ptrdiff_t x = 0; x < w; x++)
        if (unseen[y * w + x]) dark[i * columns + x / SIDE] = 0;
  }
  return OK;
}

static inline float height_at(const float *depth, ptrdiff_t columns, float x, float y) {
  const ptrdiff_t j = (ptrdiff_t)x, i = (ptrdiff_t)y;
  const float u = x - (float)j, v = y - (float)i;
  const float *at = depth + i * columns + j;
  const float upper = at[0] + u * (at[1] - at[0]), lower = at[columns] + u * (at[columns + 1] - at[columns]);
  return upper + v * (lower - upper);
}

// Whether the surface stands above a ray that leaves block (x, y) towards a light and rises by `rise` a block.
static bool is_hidden(const float *depth, ptrdiff_t x, ptrdiff_t y, const float *toward, float rise, float highest,
                      ptrdiff_t rows, ptrdiff_t columns) {
  float ray = depth[y * columns + x];
  for (int k = 1; k <= STEPS; k++) {
    const float u = (float)x + (float)k * toward[0], v = (float)y + (float)k * toward[1];
    ray += rise;
    if (!(ray < highest && u >= 0 && v >= 0 && u < (float)(columns - 1) && v < (float)(rows - 1))) return false;
    if (height_at(depth, columns, u, v) > ray) return true;
  }
  return false;
}

// The largest of `count` values from each on, `apart` from each other, doubled again and again; `count` is a power of two.
static void largest_ahead(float *values, ptrdiff_t n, ptrdiff_t apart, ptrdiff_t count) {
  for (ptrdiff_t step = 1; step < count; step *= 2)
    for (ptrdiff_t i = 0; i + step * apart < n; i++) values[i] = larger(values[i], values[i + step * apart]);
}

// The highest within REACH blocks on each side; written from the first of `padded`, with `columns` values a row.
static void highest_around(const float *depth, float *padded, float *row, ptrdiff_t rows, ptrdiff_t columns) {
  const ptrdiff_t wide = columns + 2 * REACH, all = (rows + 2 * REACH) * columns;
  for (ptrdiff_t i = 0; i < all; i++) padded[i] = -INFINITY;
  for (ptrdiff_t i = 0; i < REACH; i++) row[i] = row[wide - 1 - i] = -INFINITY;
  for (ptrdiff_t i = 0; i < rows; i++) {
    float *out = padded + (i + REACH) * columns;
    for (ptrdiff_t j = 0; j < REACH; j++) row[j] = row[wide - 1 - j] = -INFINITY;
    memcpy(row + REACH, depth + i * columns, (size_t)columns * sizeof *row);
    largest_ahead(row, wide, 1, REACH + 1);
    for (ptrdiff_t j = 0; j < columns; j++) out[j] = larger(row[j], row[j + REACH]);
  }
  largest_ahead(padded, all, columns, REACH + 1);
  for (ptrdiff_t i = 0; i < rows * columns; i++) padded[i] = larger(padded[i], padded[i + REACH * columns]);
}

// Of the blocks that are asked for, those that the lowest rays of some light do not reach, and that are lower than `upper` of
// the highest around them, above the median. Returns how many.
EXPORT int behind_hills(const float *depth, const bool *asked, const float *toward, bool *behind, float *work, float rise,
                        float upper, ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t lights, ptrdiff_t n) {
  const float highest = range_of(depth, rows * columns).high;
  float *row = work + (rows + 2 * REACH) * columns;
  int count = 0;
  if (n < (rows + 2 * REACH) * columns + columns + 2 * REACH) return WRONG_SIZE;
  memset(behind, 0, (size_t)(rows * columns) * sizeof *behind);
  for (ptrdiff_t y = 0; y < rows; y++)
    for (ptrdiff_t x = 0; x < columns; x++) {
      const ptrdiff_t at = y * columns + x;
      for (ptrdiff_t k = 0; asked[at] && !behind[at] && k < lights; k++)
        behind[at] = is_hidden(depth, x, y, toward + 2 * (at * lights + k), rise, highest, rows, columns);
      count += behind[at];
    }
  if (count == 0) return 0;
  const float rest = median(depth, rows * columns, (uint32_t *)work);
  highest_around(depth, work, row, rows, columns);
  for (ptrdiff_t i = 0; i < rows * columns; i++) {
    const bool lower = depth[i] - rest < upper * (work[i] - rest);
    count -= behind[i] && !lower;
    behind[i] &= lower;
  }
  return count;
}

struct given_back {
  float noise_square, share, least_share;
};

// What the slopes of a block in shadow change by: never so much that the surface faces the light that is hidden from it.
static void give_back(const struct given_back *rule, float dark, const float *slope, const float *toward, const float *slope_of,
                      const float *null, float *change) {
  float facing = INFINITY;
  ptrdiff_t k = 0;
  for (ptrdiff_t light = 0; light < LIGHTS; light++) {
    const float one = toward[2 * light] * slope[0] + toward[2 * light + 1] * slope[1];
    if (one < facing) facing = one, k = light;
  }
  const float lost = dark * (dark * dark) / (dark * dark + rule->noise_square) / larger(null[k], rule->least_share);
  const float p = rule->share * slope_of[2 * k] * lost, q = rule->share * slope_of[2 * k + 1] * lost;
  const float along = p * toward[2 * k] + q * toward[2 * k + 1], size = sqrtf(p * p + q * q);
  const float steep = sqrtf(slope[0] * slope[0] + slope[1] * slope[1]);
  const float turned = larger(-facing, 0) / larger(along, 1e-12f), most = smaller(turned, steep / larger(size, 1e-12f));
  change[0] = smaller(most, 1) * p, change[1] = smaller(most, 1) * q;
}

// The change of the slopes of blocks in shadow and the deviation that they get beside it; 0 elsewhere.
EXPORT int give_back_light(const bool *behind, const float *dark, const float *slopes, const float *toward, const float *slope_of,
                           const float *null, float *found, float noise_square, float share, float least_share, float doubt,
                           ptrdiff_t rows, ptrdiff_t columns) {
  const struct given_back rule = {noise_square, share, least_share};
  memset(found, 0, (size_t)(3 * rows * columns) * sizeof *found);
  for (ptrdiff_t i = 0; i < rows * columns; i++) {
    if (!behind[i]) continue;
    give_back(&rule, dark[i], slopes + 2 * i, toward + 2 * LIGHTS * i, slope_of + 2 * LIGHTS * i, null + 3 * i, found + 3 * i);
    found[3 * i + 2] = doubt;
  }
  return OK;
}

static inline bool any(const float *values, ptrdiff_t n) {
  for (ptrdiff_t i = 0; i < n; i++)
    if (values[i] != 0) return true;
  return false;
}

struct frame {
  float *gradients, *sigma, *confidence, clean_square, least;
};

static inline void doubt_pixel(const struct frame *f, ptrdiff_t at, const float *left, const float *right, float u) {
  const float p = left[0] + u * (right[0] - left[0]), q = left[1] + u * (right[1] - left[1]);
  const float doubt = left[2] + u * (right[2] - left[2]);
  const float added = p * p + q * q + doubt * doubt, total = f->sigma[at] * f->sigma[at] + added;
  if (!(added > 0)) return;
  f->gradients[2 * at] += p, f->gradients[2 * at + 1] += q;
  f->sigma[at] = sqrtf(total);
  f->confidence[at] = smaller(f->confidence[at], larger(f->clean_square / total, f->least));
}

// The columns of two rows of blocks between the first and the last of which something is found; none where last < first.
struct reach {
  ptrdiff_t first, last;
};

static inline struct reach reach_of(const float *upper, const float *lower, ptrdiff_t columns) {
  struct reach r = {0, columns - 1};
  while (r.first <= r.last && !any(upper + 3 * r.first, 3) && !any(lower + 3 * r.first, 3)) r.first++;
  while (r.first <= r.last && !any(upper + 3 * r.last, 3) && !any(lower + 3 * r.last, 3)) r.last--;
  return r;
}

// Pixels of row y whose value lies between those of blocks j and j + 1 of `line`.
static void doubt_between(const struct frame *f, const float *line, ptrdiff_t j, ptrdiff_t columns, ptrdiff_t y, ptrdiff_t w) {
  const ptrdiff_t next = columns > 1 ? 3 : 0, half = SIDE / 2;
  const ptrdiff_t first = j == 0 ? 0 : SIDE * j + half, end = j + 2 < columns ? SIDE * (j + 1) + half : w;
  if (!any(line + 3 * j, 3) && !any(line + 3 * j + next, 3)) return;
  for (ptrdiff_t x = first; x < end; x++) {
    const float u = clamp(((float)(x - SIDE * j) + 0.5f) / SIDE - 0.5f, 0, 1);
    doubt_pixel(f, y * w + x, line + 3 * j, line + 3 * j + next, u);
  }
}

// Where blocks are in shadow, the pixels' slopes change and their deviation grows, bilinearly between the blocks' middles.
EXPORT int doubt_shadows(const float *found, float *gradients, float *sigma, float *confidence, float *work, float clean,
                         float least, ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t h, ptrdiff_t w, ptrdiff_t n) {
  const struct frame f = {gradients, sigma, confidence, clean * clean, least};
  const ptrdiff_t next_row = rows > 1 ? 3 * columns : 0, most = columns > 1 ? columns - 2 : 0;
  if (rows != (h + SIDE - 1) / SIDE || columns != (w + SIDE - 1) / SIDE || n < 3 * columns) return WRONG_SIZE;
  const float *held = NULL;  // of which `r` is
  struct reach r = {0, -1};
  for (ptrdiff_t y = 0; y < h; y++) {
    float v;
    const float *upper = found + between(y, 1.0 / SIDE, rows, &v) * 3 * columns, *lower = upper + next_row;
    if (upper != held) r = reach_of(upper, lower, columns);
    held = upper;
    if (r.first > r.last) continue;
    for (ptrdiff_t k = 0; k < 3 * columns; k++) work[k] = upper[k] + v * (lower[k] - upper[k]);
    for (ptrdiff_t j = r.first > 0 ? r.first - 1 : 0; j <= most && j <= r.last; j++) doubt_between(&f, work, j, columns, y, w);
  }
  return OK;
}
