#include "batch.h"

#include <stdlib.h>

static ptrdiff_t pixels_of(const struct batch_level *l) { return (l->height + 3) * l->stride; }

// The sizes that the levels of a `struct multigrid` of this frame have.
static void set_sizes(struct batch *b, ptrdiff_t height, ptrdiff_t width) {
  ptrdiff_t h = on_finest(height, height), w = on_finest(width, width);
  for (b->count = 0;; h = (h + 1) / 2, w = (w + 1) / 2) {
    b->levels[b->count++] = (struct batch_level){.height = h, .width = w, .stride = w + 3};
    if (h * w <= COARSEST) return;
  }
}

EXPORT void batch_free(void *batch) {
  struct batch *b = batch;
  free(b->memory);
  free(b);
}

EXPORT void *batch_new(ptrdiff_t height, ptrdiff_t width) {
  struct batch *b = calloc(1, sizeof *b);
  if (!b) return NULL;
  set_sizes(b, height, width);
  ptrdiff_t total = 1;
  for (int k = 0; k < b->count; k++) total += 3 * pixels_of(&b->levels[k]);
  b->memory = calloc(total, sizeof(lanes));
  if (!b->memory) {
    batch_free(b);
    return NULL;
  }
  const ptrdiff_t skipped = (BATCH - (uintptr_t)b->memory / sizeof(float) % BATCH) % BATCH;  // to where a vector may begin
  lanes *next = (lanes *)(b->memory + skipped);
  for (int k = 0; k < b->count; k++) {
    struct batch_level *l = &b->levels[k];
    l->right = next, l->guess = l->right + pixels_of(l), l->answer = l->guess + pixels_of(l);
    next = l->answer + pixels_of(l);
  }
  return b;
}

bool batch_fits(const struct batch *b, const struct multigrid *m) {
  if (b->count != m->count) return false;
  for (int k = 0; k < b->count; k++)
    if (b->levels[k].height != m->levels[k].height || b->levels[k].width != m->levels[k].width) return false;
  return true;
}
