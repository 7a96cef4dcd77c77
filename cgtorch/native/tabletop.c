/* Which motions of the base are clear of what stands around it (cgtorch.tabletop.world.clear_way). */
#include "parallel.h"
#include "tabletop.h"

typedef struct {
  const real *motion, *things;
  const Body *body;
  int64_t count;
  unsigned char *free;
} Rows;

/* The k-th things of up to WIDTH rows. */
INLINE Rectangle things_of(const Rows *r, int64_t begin, int64_t rows, int64_t k) {
  vec thing[5];
  into_columns(r->things + (begin * r->count + k) * 5, rows, r->count * 5, 5, thing);
  Rectangle found = {.x = thing[0], .y = thing[1], .sx = thing[3], .sy = thing[4]};
  sine_cosine(thing[2], &found.s, &found.c);
  return found;
}

static void some_motions(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
  for (int64_t row = begin; row < end; row += WIDTH) {
    int64_t rows = end - row < WIDTH ? end - row : WIDTH;
    vec u[3];
    into_columns(r->motion + row * 3, rows, 3, 3, u);
    vwhole free = is_within(u, r->body);
    for (int64_t k = 0; k < r->count; k++) {
      Rectangle thing = things_of(r, row, rows, k);
      free = clear_of(u, &thing, r->body, free);
    }
    for (int64_t i = 0; i < rows; i++) r->free[row + i] = free[i] != 0;
  }
}

/* Whether motions (n, 3) can be made beside things (n, count, 5). */
int motions_possible(const real *motion, const real *things, const Body *body, int64_t n, int64_t count,
                     unsigned char *free, int64_t threads) {
  Rows rows = {motion, things, body, count, free};
  in_parallel(some_motions, &rows, n, 1024, threads);
  return 0;
}
