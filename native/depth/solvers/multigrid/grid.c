#include "grid.h"

#include <stdlib.h>

enum { ALIGNED = 16, FINEST_PLANES = 9, COARSE_PLANES = 8 + WEIGHTS };

// A row length that is no multiple of 1 KiB: rows at such distances share few lines of the cache.
static ptrdiff_t stride_of(ptrdiff_t width) {
  const ptrdiff_t stride = (width + 4 + ALIGNED - 1) / ALIGNED * ALIGNED;
  return stride % 256 == 0 ? stride + ALIGNED : stride;
}

static ptrdiff_t plane_size(const struct level *l) { return (l->height + 3) * l->stride + 2 * ALIGNED; }

static void set_sizes(struct multigrid *m, ptrdiff_t height, ptrdiff_t width) {
  m->height = height, m->width = width, m->count = 1;
  m->levels[0].height = on_finest(height, height), m->levels[0].width = on_finest(width, width);
  m->levels[0].stride = stride_of(m->levels[0].width);
  for (const struct level *l = m->levels; l->height * l->width > COARSEST; l++, m->count++) {
    const ptrdiff_t h = (l->height + 1) / 2, w = (l->width + 1) / 2;
    m->levels[m->count] = (struct level){.height = h, .width = w, .stride = stride_of(w)};
  }
  m->line = m->levels[0].stride + ALIGNED;
  m->coarse_line = m->line / 2 + 3 * ALIGNED;
}

static ptrdiff_t memory_needed(const struct multigrid *m) {
  ptrdiff_t total = ALIGNED + COARSEST * COARSEST;
  total += COARSEN_LINES * m->coarse_line;  // more than CYCLE_LINES * m->line
  for (int k = 0; k < m->count; k++) total += plane_size(&m->levels[k]) * (k ? COARSE_PLANES : FINEST_PLANES);
  return total;
}

static float *take(float **free_memory, ptrdiff_t size) {
  float *taken = *free_memory;
  *free_memory += size;
  return taken;
}

static void share_out(struct multigrid *m, float *memory) {
  for (int k = 0; k < m->count; k++) {
    struct level *l = &m->levels[k];
    float **shared[] = {&l->east, &l->south, &l->anchor, &l->inverse, &l->right, &l->answer};
    for (int p = 0; p < 6; p++) *shared[p] = take(&memory, plane_size(l));
    float **finest[] = {&m->depth, &m->search, &m->product}, **coarse[] = {&l->southeast, &l->southwest};
    for (int p = 0; p < (k ? 2 : 3); p++) *(k ? coarse : finest)[p] = take(&memory, plane_size(l));
    for (int p = 0; k && p < WEIGHTS; p++) l->weights[p] = take(&memory, plane_size(l));
  }
  m->dense = take(&memory, COARSEST * COARSEST);
  m->lines = memory;
}

EXPORT void multigrid_free(void *grid) {
  struct multigrid *m = grid;
  free(m->memory);
  free(m->elimination);
  free(m);
}

EXPORT void *multigrid_new(ptrdiff_t height, ptrdiff_t width) {
  struct multigrid *m = calloc(1, sizeof *m);
  if (!m) return NULL;
  set_sizes(m, height, width);
  m->memory = calloc(memory_needed(m), sizeof(float));
  m->elimination = calloc(2 * COARSEST * COARSEST, sizeof(double));
  if (!m->memory || !m->elimination) {
    multigrid_free(m);
    return NULL;
  }
  const ptrdiff_t skipped = ALIGNED - 1 - (uintptr_t)m->memory / sizeof(float) % ALIGNED;
  share_out(m, m->memory + skipped);
  return m;
}
