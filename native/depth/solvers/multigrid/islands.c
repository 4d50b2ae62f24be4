// Small islands of trusted pixels among pixels that count for little.
//
// An island holds together and moves nearly as one. Jacobi's method moves it slowly, for its pixels are tied to each other,
// and interpolation from a regular grid cannot move an odd shape without bending it. So each island's mean is a degree of
// freedom of its own: before and after the coarse levels it moves as far as its residuals ask for, and takes its shore, the
// pixels around it, along by their share. This is added to Jacobi's step, which leaves the cycle symmetric; and positive,
// since islands are only what is tied weakly.
#include "grid.h"

#include <stdlib.h>

// A coupling under this share of a trusted pixel's is no part of an island; islands are tied to what is around them by less
// than so much of their mean coupling inside; and they are small: the coarse levels see the others.
static const float STRONG = 0.05f, WEAK = 0.25f;
enum { MOST_PIXELS = 24, MOST_WITH_SHORE = 80 };

// An island in the making.
struct search {
  const struct level *l;
  float strong_east, strong_south;
  ptrdiff_t place[MOST_WITH_SHORE];
  float share[MOST_WITH_SHORE];  // how far a pixel goes where the island moves by 1
  int count;
};

static float share_of(const struct search *s, ptrdiff_t place) {
  for (int k = 0; k < s->count; k++)
    if (s->place[k] == place) return s->share[k];
  return 0;
}

static bool is_new(const struct search *s, ptrdiff_t place) { return share_of(s, place) == 0; }

// The four neighbors of a pixel, and its couplings to them.
struct around {
  ptrdiff_t place[4];
  float tie[4];
};

static struct around around(const struct level *l, ptrdiff_t p) {
  const ptrdiff_t up = p - l->stride;
  return (struct around){{p + 1, p - 1, p + l->stride, up}, {l->east[p], l->east[p - 1], l->south[p], l->south[up]}};
}

// False if the island is too large, or was found from a pixel before `first`.
static bool join(struct search *s, ptrdiff_t place) {
  if (!is_new(s, place)) return true;
  if (s->count == MOST_PIXELS || place < s->place[0]) return false;
  s->place[s->count] = place;
  s->share[s->count++] = 1;
  return true;
}

static bool grow(struct search *s) {
  for (int k = 0; k < s->count; k++) {
    const struct around near = around(s->l, s->place[k]);
    for (int d = 0; d < 4; d++)
      if (near.tie[d] >= (d < 2 ? s->strong_east : s->strong_south) && !join(s, near.place[d])) return false;
  }
  return s->count > 1;
}

// It is tied to its surroundings, by little of what holds it together.
static bool is_weakly_tied(const struct search *s) {
  float inside = 0, outside = 0;
  for (int k = 0; k < s->count; k++) {
    const struct around near = around(s->l, s->place[k]);
    for (int d = 0; d < 4; d++) *(is_new(s, near.place[d]) ? &outside : &inside) += near.tie[d];
    outside += s->l->anchor[s->place[k]];
  }
  return outside > 0 && outside < WEAK * 0.5f * inside / (s->count - 1);
}

// Pixels around it follow by their ties to it, as a share of all their ties.
static void add_shore(struct search *s) {
  const int inner = s->count;
  for (int k = 0; k < inner; k++) {
    const struct around shore = around(s->l, s->place[k]);
    for (int d = 0; d < 4; d++) {
      const ptrdiff_t p = shore.place[d];
      if (shore.tie[d] == 0 || !is_new(s, p) || s->count == MOST_WITH_SHORE) continue;
      const struct around near = around(s->l, p);
      float tied = 0;
      for (int e = 0; e < 4; e++)
        for (int q = 0; q < inner; q++) tied += s->place[q] == near.place[e] ? near.tie[e] : 0;
      s->place[s->count] = p;
      s->share[s->count++] = tied * s->l->inverse[p];
    }
  }
}

// Coupling that holds the island and its shore in place: fractions times operator times fractions.
static float tie_of(const struct search *s) {
  float tie = 0;
  for (int k = 0; k < s->count; k++) {
    const struct around near = around(s->l, s->place[k]);
    float pull = s->l->anchor[s->place[k]] * s->share[k];
    for (int d = 0; d < 4; d++) pull += near.tie[d] * (s->share[k] - share_of(s, near.place[d]));
    tie += s->share[k] * pull;
  }
  return tie;
}

static void keep(struct islands *found, const struct search *s) {
  const float tie = tie_of(s);
  if (found->count == MAX_ISLANDS || found->pixels + s->count > MAX_ISLAND_PIXELS || !(tie > 0)) return;
  for (int k = 0; k < s->count; k++)
    found->pixel[found->pixels++] =
        (struct island_pixel){s->place[k] / s->l->stride, s->place[k] % s->l->stride, found->count, s->share[k]};
  found->tie[found->count++] = tie;
}

// The pixel has no strong tie upwards, and nor has any that it is tied to on its right: a top row of an island.
static bool is_top_row(const struct search *s, ptrdiff_t place) {
  const struct level *l = s->l;
  for (;; place++) {
    if (l->south[place - l->stride] >= s->strong_south) return false;
    if (l->east[place] < s->strong_east) return true;
  }
}

static int by_row(const void *a, const void *b) {
  const struct island_pixel *one = a, *other = b;
  return one->row != other->row ? one->row - other->row : one->column - other->column;
}

void find_islands(struct multigrid *m) {
  const struct level *l = m->levels;
  struct islands *found = &m->islands;
  struct search s = {.l = l};
  found->count = found->pixels = 0;
  for (ptrdiff_t i = 1; i <= l->height; i++) {
    s.strong_east = larger(s.strong_east, STRONG * range_of(row(l->east, l, i) + 1, l->width).high);
    s.strong_south = larger(s.strong_south, STRONG * range_of(row(l->south, l, i) + 1, l->width).high);
  }
  for (ptrdiff_t i = 1; i <= l->height && m->count > 1; i++)
    for (ptrdiff_t p = i * l->stride + 1; p <= i * l->stride + l->width; p++) {
      if (l->east[p - 1] >= s.strong_east || l->south[p - l->stride] >= s.strong_south) continue;
      if ((l->east[p] < s.strong_east && l->south[p] < s.strong_south) || !is_top_row(&s, p)) continue;
      s.place[0] = p, s.share[0] = 1, s.count = 1;
      if (!grow(&s) || !is_weakly_tied(&s)) continue;
      add_shore(&s);
      keep(found, &s);
    }
  qsort(found->pixel, found->pixels, sizeof *found->pixel, by_row);
}

static ptrdiff_t place_of(const struct level *l, const struct island_pixel *p) { return p->row * l->stride + p->column; }

static void shift_by_residuals(struct islands *islands) {
  for (int k = 0; k < islands->count; k++) {
    islands->shift[k] = islands->residual[k] / islands->tie[k];
    islands->residual[k] = 0;
  }
  islands->next = islands->next_residual = 0;
}

// Before a cycle: how far the right side, once the pending step is taken, asks each island to move.
void shift_before(struct multigrid *m, struct step step) {
  struct islands *islands = &m->islands;
  const float length = step.pending ? step.length : 0;
  memset(islands->residual, 0, islands->count * sizeof *islands->residual);
  for (int k = 0; k < islands->pixels; k++) {
    const ptrdiff_t p = place_of(m->levels, &islands->pixel[k]);
    islands->residual[islands->pixel[k].island] += islands->pixel[k].share * (m->levels->right[p] - length * m->product[p]);
  }
  shift_by_residuals(islands);
}

// Before the last pass, which needs the same shifts again.
void shift_between(struct multigrid *m) { m->islands.next = m->islands.next_residual = 0; }

void add_shifts(struct islands *islands, ptrdiff_t row, float *guess) {
  for (; islands->next < islands->pixels && islands->pixel[islands->next].row == row; islands->next++) {
    const struct island_pixel *p = &islands->pixel[islands->next];
    guess[p->column] += p->share * islands->shift[p->island];
  }
}

// The shifts of these pixels reduce their residuals by shift times the diagonal.
void subtract_shifts(struct multigrid *m, ptrdiff_t row, float *residual) {
  struct islands *islands = &m->islands;
  for (; islands->next_residual < islands->pixels && islands->pixel[islands->next_residual].row == row; islands->next_residual++) {
    const struct island_pixel *p = &islands->pixel[islands->next_residual];
    residual[p->column] -= p->share * islands->shift[p->island] / m->levels->inverse[place_of(m->levels, p)];
  }
}

// Residual of a guess and its neighbors: their weighted sum minus diagonal times guess.
void add_residuals(struct multigrid *m, ptrdiff_t row, const float *guess, const float *tied) {
  struct islands *islands = &m->islands;
  for (; islands->next_residual < islands->pixels && islands->pixel[islands->next_residual].row == row; islands->next_residual++) {
    const struct island_pixel *p = &islands->pixel[islands->next_residual];
    const float residual = tied[p->column] - guess[p->column] / m->levels->inverse[place_of(m->levels, p)];
    islands->residual[p->island] += p->share * residual;
  }
}

// After the last pass: move the islands in the answer too.
void shift_after(struct multigrid *m, struct answer *answer) {
  struct islands *islands = &m->islands;
  shift_by_residuals(islands);
  for (int k = 0; k < islands->pixels; k++) {
    const ptrdiff_t p = place_of(m->levels, &islands->pixel[k]);
    const float shift = islands->pixel[k].share * islands->shift[islands->pixel[k].island], moved = m->levels->answer[p] += shift;
    answer->product += (double)shift * m->levels->right[p];
    answer->low = smaller(moved, answer->low);
    answer->high = larger(moved, answer->high);
  }
}
