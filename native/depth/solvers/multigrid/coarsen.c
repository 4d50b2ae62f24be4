// Coarse operators from the fine one.
//
// Black-box multigrid (J. E. Dendy, Black box multigrid, J. Comput. Phys. 48, 1982): interpolation weights come from the
// operator itself, so that they follow jumps of the couplings by any factor. A pixel between two coarse pixels takes its
// collapsed couplings to the columns left and right of it (or the rows above and below) as weights; the pixel in the
// middle of four is eliminated exactly. The coarse operator is P^T A P, assembled block by block as in finite elements: a
// block has four coarse corners, four pixels on its sides and one in its middle.
//
// The diagonal is never stored: it is the sum of the couplings and the anchor, which keeps row sums exact in float32.
// Without an anchor P 1 = 1. With one P 1 = 1 - lack, and the coarse anchor P^T A P 1 is computed from the lacks alone,
// where nothing cancels.
#include "grid.h"

// Added to a sum of couplings that may be 0, so that 0/0 is 0 without a branch.
static const float TINY = 1e-30f;

// A row of pixels, each between two coarse pixels, passes on its residual, a coupling, and anchors to both.
struct sides {
  float *lack, *coupling, *anchor_1, *anchor_2;
};

// The middles of a row of blocks pass on couplings between the corners, and anchors to them.
struct middles {
  float *top, *left, *low, *right, *falling, *rising, *anchor_nw, *anchor_ne, *anchor_sw, *anchor_se;
};

struct lines {
  struct sides across, across_low, down, down_above;
  struct middles blocks, blocks_above;
};

struct between {
  float weight_1, weight_2, lack, coupling, anchor_1, anchor_2;
};

// A pixel between two coarse pixels: couplings to both, collapsed diagonal couplings to their columns or rows, couplings
// along the pixels between, and anchor. An anchor takes no more than its share of all that holds the pixel: one that is tied
// weakly to both coarse pixels, and firmly to others between, would else be held at 0, and they with it.
static inline struct between eliminate_side(float c1, float c2, float side1, float side2, float along, float anchor) {
  // Collapsed couplings can be slightly negative where columns are coupled far more strongly than rows.
  float w1 = fabsf(c1 + side1), w2 = fabsf(c2 + side2);
  const float sum = w1 + w2, held = sum + (sum > 0 ? along : 0) + anchor + TINY;
  const float lack = anchor / held, scale = (1 - lack) / (sum + TINY);
  w1 *= scale, w2 *= scale;
  const float stiff = c1 + c2 + anchor, rest = anchor - stiff * lack;
  const float coupling = c1 * w2 + c2 * w1 - w1 * w2 * stiff;
  return (struct between){w1, w2, lack, coupling, c1 * lack + w1 * rest, c2 * lack + w2 * rest};
}

// Pixels right of the coarse pixels (I, J), which lie in row `i` of the coarse level.
static inline void across(const struct level *f, const struct level *c, ptrdiff_t i, bool diagonals, const struct sides *s) {
  const float *e = row(f->east, f, 2 * i - 1), *a = row(f->anchor, f, 2 * i - 1);
  const float *s_low = row(f->south, f, 2 * i - 1), *s_up = s_low - f->stride;
  const float *se = diagonals ? row(f->southeast, f, 2 * i - 1) : e, *sw = diagonals ? row(f->southwest, f, 2 * i - 1) : e;
  const float *se_up = se - f->stride, *sw_up = sw - f->stride;
  float *left = row(c->weights[LEFT], c, i), *right = row(c->weights[RIGHT], c, i);
  const struct sides o = *s;
  INDEPENDENT for (ptrdiff_t j = 1; j <= c->width; j++) {
    const float side1 = diagonals ? se_up[2 * j - 1] + sw[2 * j] : 0, side2 = diagonals ? se[2 * j] + sw_up[2 * j + 1] : 0;
    const struct between b = eliminate_side(e[2 * j - 1], e[2 * j], side1, side2, s_low[2 * j] + s_up[2 * j], a[2 * j]);
    left[j] = b.weight_1, right[j] = b.weight_2;
    o.lack[j] = b.lack, o.coupling[j] = b.coupling, o.anchor_1[j] = b.anchor_1, o.anchor_2[j] = b.anchor_2;
  }
}

// Pixels below the coarse pixels (I, J): also beyond the last, as right sides of the last blocks.
static inline void down(const struct level *f, const struct level *c, ptrdiff_t i, bool diagonals, const struct sides *s) {
  const float *s_low = row(f->south, f, 2 * i), *s_up = s_low - f->stride, *e = row(f->east, f, 2 * i);
  const float *a = row(f->anchor, f, 2 * i);
  const float *se = diagonals ? row(f->southeast, f, 2 * i) : a, *sw = diagonals ? row(f->southwest, f, 2 * i) : a;
  const float *se_up = se - f->stride, *sw_up = sw - f->stride;
  float *up = row(c->weights[UP], c, i), *low = row(c->weights[DOWN], c, i);
  const struct sides o = *s;
  INDEPENDENT for (ptrdiff_t j = 1; j <= c->width + 1; j++) {
    const float side1 = diagonals ? se_up[2 * j - 2] + sw_up[2 * j] : 0, side2 = diagonals ? se[2 * j - 1] + sw[2 * j - 1] : 0;
    const struct between b = eliminate_side(s_up[2 * j - 1], s_low[2 * j - 1], side1, side2, e[2 * j - 1] + e[2 * j - 2], a[2 * j - 1]);
    up[j] = b.weight_1, low[j] = b.weight_2;
    o.lack[j] = b.lack, o.coupling[j] = b.coupling, o.anchor_1[j] = b.anchor_1, o.anchor_2[j] = b.anchor_2;
  }
}

// The middles of the blocks right of and below the coarse row `i`.
static inline void middles(const struct level *f, const struct level *c, ptrdiff_t i, bool diagonals, const struct lines *t) {
  const ptrdiff_t k = 2 * i;
  const float *e = row(f->east, f, k), *s_low = row(f->south, f, k), *s_up = s_low - f->stride, *a = row(f->anchor, f, k);
  const float *se = diagonals ? row(f->southeast, f, k) : e, *sw = diagonals ? row(f->southwest, f, k) : e;
  const float *se_up = se - f->stride, *sw_up = sw - f->stride;
  const float *left_up = row(c->weights[LEFT], c, i), *right_up = row(c->weights[RIGHT], c, i);
  const float *left_low = left_up + c->stride, *right_low = right_up + c->stride;
  const float *up = row(c->weights[UP], c, i), *low = row(c->weights[DOWN], c, i);
  float *from_nw = row(c->weights[FROM_NW], c, i), *from_ne = row(c->weights[FROM_NE], c, i);
  float *from_sw = row(c->weights[FROM_SW], c, i), *from_se = row(c->weights[FROM_SE], c, i);
  const float *lack_up = t->across.lack, *lack_low = t->across_low.lack, *lack_side = t->down.lack;
  const struct middles o = t->blocks;
  INDEPENDENT for (ptrdiff_t j = 1; j <= c->width; j++) {
    const float tl = left_up[j], tr = right_up[j], bl = left_low[j], br = right_low[j];
    const float lu = up[j], ld = low[j], ru = up[j + 1], rd = low[j + 1];
    const float north = s_up[2 * j], south = s_low[2 * j], west = e[2 * j - 1], east = e[2 * j];
    const float lack_n = north * lack_up[j], lack_s = south * lack_low[j];
    const float lack_w = west * lack_side[j], lack_e = east * lack_side[j + 1];
    // Couplings of the middle, collapsed onto the corners.
    const float nw = tl * north + lu * west + (diagonals ? se_up[2 * j - 1] : 0);
    const float ne = tr * north + ru * east + (diagonals ? sw_up[2 * j + 1] : 0);
    const float sw_ = bl * south + ld * west + (diagonals ? sw[2 * j] : 0);
    const float se_ = br * south + rd * east + (diagonals ? se[2 * j] : 0);
    float lack = lack_n + lack_s + lack_w + lack_e + a[2 * j];
    const float scale = 1.0f / (nw + ne + sw_ + se_ + lack + TINY);
    lack *= scale;
    const float p_nw = nw * scale, p_ne = ne * scale, p_sw = sw_ * scale, p_se = se_ * scale;
    from_nw[j] = p_nw, from_ne[j] = p_ne, from_sw[j] = p_sw, from_se[j] = p_se;
    o.top[j] = nw * p_ne - tl * tr * north, o.left[j] = nw * p_sw - lu * ld * west;
    o.low[j] = sw_ * p_se - bl * br * south, o.right[j] = ne * p_se - ru * rd * east;
    o.falling[j] = nw * p_se, o.rising[j] = ne * p_sw;
    o.anchor_nw[j] = nw * lack - tl * lack_n - lu * lack_w, o.anchor_ne[j] = ne * lack - tr * lack_n - ru * lack_e;
    o.anchor_sw[j] = sw_ * lack - bl * lack_s - ld * lack_w, o.anchor_se[j] = se_ * lack - br * lack_s - rd * lack_e;
  }
}

// The couplings between the side pixels of a block, across the corners of the fine cells, pass this on.
static void corners(const struct level *f, const struct level *c, ptrdiff_t i, const struct lines *t) {
  const float *se = row(f->southeast, f, 2 * i), *sw = row(f->southwest, f, 2 * i);
  const float *se_up = se - f->stride, *sw_up = sw - f->stride;
  const float *left_up = row(c->weights[LEFT], c, i), *right_up = row(c->weights[RIGHT], c, i);
  const float *left_low = left_up + c->stride, *right_low = right_up + c->stride;
  const float *up = row(c->weights[UP], c, i), *low = row(c->weights[DOWN], c, i);
  const float *lack_up = t->across.lack, *lack_low = t->across_low.lack, *lack_side = t->down.lack;
  const struct middles o = t->blocks;
  INDEPENDENT for (ptrdiff_t j = 1; j <= c->width; j++) {
    const float tl = left_up[j], tr = right_up[j], bl = left_low[j], br = right_low[j];
    const float lu = up[j], ld = low[j], ru = up[j + 1], rd = low[j + 1];
    const float top = lack_up[j], bottom = lack_low[j], west = lack_side[j], east = lack_side[j + 1];
    const float tie_nw = sw_up[2 * j], tie_ne = se_up[2 * j], tie_sw = se[2 * j - 1], tie_se = sw[2 * j + 1];
    const float nw = tie_nw * (tl - lu), ne = tie_ne * (tr - ru), s_w = tie_sw * (ld - bl), s_e = tie_se * (rd - br);
    o.top[j] -= nw * tr + ne * tl, o.left[j] += nw * ld - s_w * lu;
    o.low[j] += s_w * br + s_e * bl, o.right[j] += ne * rd - s_e * ru;
    o.falling[j] += tie_ne * tl * rd + tie_sw * lu * br, o.rising[j] += tie_nw * tr * ld + tie_se * ru * bl;
    const float d_nw = west - top, d_ne = east - top, d_sw = bottom - west, d_se = bottom - east;
    o.anchor_nw[j] += nw * d_nw + tie_ne * tl * d_ne + tie_sw * lu * d_sw;
    o.anchor_ne[j] += tie_nw * tr * d_nw + ne * d_ne + tie_se * ru * d_se;
    o.anchor_sw[j] += s_w * d_sw - tie_nw * ld * d_nw - tie_se * bl * d_se;
    o.anchor_se[j] += s_e * d_se - tie_ne * rd * d_ne - tie_sw * br * d_sw;
  }
}

// The operator's coarse row `i`, from the sides and blocks around it; the fine anchor of the coarse pixels themselves.
static void assemble(const struct level *f, const struct level *c, ptrdiff_t i, const struct lines *t) {
  const float *own = row(f->anchor, f, 2 * i - 1);
  float *e = row(c->east, c, i), *s = row(c->south, c, i), *se = row(c->southeast, c, i), *sw = row(c->southwest, c, i);
  float *anchor = row(c->anchor, c, i), *inverse = row(c->inverse, c, i);
  const float *s_up = s - c->stride, *se_up = se - c->stride, *sw_up = sw - c->stride;
  const struct sides h = t->across, v = t->down, v_above = t->down_above;
  const struct middles b = t->blocks, above = t->blocks_above;
  INDEPENDENT for (ptrdiff_t j = 1; j <= c->width; j++) {
    e[j] = h.coupling[j] + b.top[j] + above.low[j];
    s[j] = v.coupling[j] + b.left[j] + b.right[j - 1];
    se[j] = b.falling[j], sw[j] = b.rising[j - 1];
    const float sides = h.anchor_1[j] + h.anchor_2[j - 1] + v.anchor_1[j] + v_above.anchor_2[j];
    const float blocks = b.anchor_nw[j] + b.anchor_ne[j - 1] + above.anchor_sw[j] + above.anchor_se[j - 1];
    anchor[j] = own[2 * j - 1] + (sides + blocks);
  }
  INDEPENDENT for (ptrdiff_t j = 1; j <= c->width; j++) {
    const float ties = e[j] + e[j - 1] + s[j] + s_up[j] + se[j] + se_up[j - 1] + sw[j] + sw_up[j + 1];
    const float total = ties + larger(anchor[j], 0);  // an anchor that rounding made negative counts as none
    inverse[j] = total > 0 ? 1.0f / total : 0.0f;
  }
}

static struct lines lines_of(const struct multigrid *m) {
  struct lines t;
  float **all = (float **)&t;
  for (size_t k = 0; k < sizeof t / sizeof *all; k++) all[k] = m->lines + k * m->coarse_line;
  return t;
}

static void next_row(struct lines *t) {
  const struct sides across = t->across, down = t->down;
  const struct middles blocks = t->blocks;
  t->across = t->across_low, t->across_low = across;
  t->down = t->down_above, t->down_above = down;
  t->blocks = t->blocks_above, t->blocks_above = blocks;
}

static void clear_sides(const struct sides *s, ptrdiff_t n) {
  float *each[] = {s->lack, s->coupling, s->anchor_1, s->anchor_2};
  for (int k = 0; k < 4; k++) memset(each[k], 0, n * sizeof(float));
}

void coarsen(const struct multigrid *m, int level) {
  const struct level *f = &m->levels[level], *c = f + 1;
  const bool diagonals = level > 0;
  struct lines t = lines_of(m);
  memset(m->lines, 0, COARSEN_LINES * m->coarse_line * sizeof(float));
  for (ptrdiff_t i = 0; i <= c->height; i++, next_row(&t)) {
    if (i == c->height) clear_sides(&t.across_low, m->coarse_line);
    else if (diagonals) across(f, c, i + 1, true, &t.across_low);
    else across(f, c, i + 1, false, &t.across_low);
    if (i == 0) continue;
    if (diagonals) down(f, c, i, true, &t.down), middles(f, c, i, true, &t), corners(f, c, i, &t);
    else down(f, c, i, false, &t.down), middles(f, c, i, false, &t);
    assemble(f, c, i, &t);
  }
}
