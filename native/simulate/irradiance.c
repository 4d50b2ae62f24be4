// Light of near point lights on a surface; see simulate/light.py for the formula.
#include "../common.h"

enum { BLOCK = 256, OF_LED = 10 };  // pixels at once; numbers of an LED: place, color, axis, power of the beam

struct columns {
  float x[BLOCK], z[BLOCK], p[BLOCK], q[BLOCK], cosine[BLOCK];  // the surface; cosine of its tilt
  float near[BLOCK], lit[BLOCK];                                 // one over the distance; light of one LED
  float light[3][BLOCK];                                         // of all LEDs
};

static void surface_at(struct columns *c, const double *restrict x, const double *restrict z, const double *restrict g,
                       const float *restrict texture, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) {
    c->x[j] = (float)x[j], c->z[j] = (float)z[j];
    c->p[j] = (float)g[2 * j], c->q[j] = (float)g[2 * j + 1];
  }
  if (texture)
    for (ptrdiff_t j = 0; j < n; j++) c->p[j] += texture[2 * j], c->q[j] += texture[2 * j + 1];
  for (ptrdiff_t j = 0; j < n; j++) c->cosine[j] = 1 / sqrtf(1 + c->p[j] * c->p[j] + c->q[j] * c->q[j]);
  memset(c->light, 0, sizeof c->light);
}

static void lambert(struct columns *c, const float *led, float dy, ptrdiff_t n) {
  for (ptrdiff_t j = 0; j < n; j++) {
    const float dx = led[0] - c->x[j], dz = led[2] - c->z[j];
    const float near = 1 / sqrtf(dx * dx + dy * dy + dz * dz);
    const float facing = larger(dz - c->p[j] * dx - c->q[j] * dy, 0);
    c->near[j] = near;
    c->lit[j] = facing * c->cosine[j] * near * near * near;
  }
}

// Blinn's: the cosine of the half angle is squared, so that no root is needed, then `doublings - 1` times more.
static void add_gloss(struct columns *c, const float *led, float dy, float specular, int doublings, ptrdiff_t n) {
  float gloss[BLOCK];
  for (ptrdiff_t j = 0; j < n; j++) {
    const float dx = (led[0] - c->x[j]) * c->near[j], dz = (led[2] - c->z[j]) * c->near[j];
    const float half = larger((dz + 1 - c->p[j] * dx - c->q[j] * dy * c->near[j]) * c->cosine[j], 0);
    gloss[j] = half * half / (2 + 2 * dz);
  }
  if (doublings == 0)
    for (ptrdiff_t j = 0; j < n; j++) gloss[j] = sqrtf(gloss[j]);
  for (int k = 1; k < doublings; k++)
    for (ptrdiff_t j = 0; j < n; j++) gloss[j] *= gloss[j];
  for (ptrdiff_t j = 0; j < n; j++) {
    const float shown = c->lit[j] > 0 ? specular : 0;
    c->lit[j] += shown * gloss[j] * c->near[j] * c->near[j];
  }
}

static void in_beam(struct columns *c, const float *led, float dy, ptrdiff_t n) {
  for (int k = 0; k < (int)led[9]; k++)
    for (ptrdiff_t j = 0; j < n; j++) {
      const float along = led[6] * (c->x[j] - led[0]) - led[7] * dy + led[8] * (c->z[j] - led[2]);
      c->lit[j] *= larger(along * c->near[j], 0);
    }
}

static void past_surface(struct columns *c, const float *restrict seen, ptrdiff_t start, int oversample, ptrdiff_t n) {
  if (oversample == 1)
    for (ptrdiff_t j = 0; j < n; j++) c->lit[j] *= seen[start + j];
  else
    for (ptrdiff_t j = 0; j < n; j++) c->lit[j] *= seen[(int32_t)(start + j) / oversample];
}

static void add_colors(struct columns *c, const float *led, ptrdiff_t n) {
  for (int k = 0; k < 3; k++)
    if (led[3 + k] > 0)
      for (ptrdiff_t j = 0; j < n; j++) c->light[k][j] += led[3 + k] * c->lit[j];
}

// Adds to `out`, which is 0 at first; every pixel takes the light of all its samples.
EXPORT int irradiance(const double *x, const double *y, const double *z, const double *gradients, const float *texture,
                      const float *leds, const float *visible, float *out, float specular, int32_t doublings,
                      int32_t oversample, ptrdiff_t w, ptrdiff_t h, ptrdiff_t lights, ptrdiff_t rows,
                      ptrdiff_t columns) {
  if (rows * oversample != h || columns * oversample != w) return WRONG_SIZE;
  for (ptrdiff_t i = 0; i < h; i++)
    for (ptrdiff_t start = 0; start < w; start += BLOCK) {
      const ptrdiff_t n = w - start < BLOCK ? w - start : BLOCK, at = i * w + start, row = i / oversample * columns;
      struct columns c;
      surface_at(&c, x + start, z + at, gradients + 2 * at, texture ? texture + 2 * at : NULL, n);
      for (ptrdiff_t k = 0; k < lights; k++) {
        const float *led = leds + OF_LED * k, dy = led[1] - (float)y[i];
        lambert(&c, led, dy, n);
        if (specular > 0) add_gloss(&c, led, dy, specular, doublings, n);
        in_beam(&c, led, dy, n);
        if (visible) past_surface(&c, visible + k * rows * columns + row, start, oversample, n);
        add_colors(&c, led, n);
      }
      for (ptrdiff_t j = 0; j < n; j++)
        for (int k = 0; k < 3; k++) out[3 * (row + (int32_t)(start + j) / oversample) + k] += c.light[k][j];
    }
  return OK;
}
