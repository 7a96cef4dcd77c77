/* Which motions of the base are clear of what stands around it (cgtorch.world.clear_way). */
#include "parallel.h"
#include "tabletop.h"

typedef struct {
  const real *motion, *things;
  const Body *body;
  int64_t count;
  unsigned char *free;
} Rows;

static void some_motions(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
  for (int64_t i = begin; i < end; i++) {
    const real *u = r->motion + i * 3, *thing = r->things + i * r->count * 5;
    int free = is_within(u, r->body);
    for (int64_t k = 0; k < r->count && free; k++, thing += 5)
      free = is_clear(u, (Rectangle){thing[0], thing[1], thing[2], thing[3], thing[4]}, r->body);
    r->free[i] = (unsigned char)free;
  }
}

/* Whether motions (n, 3) can be made beside things (n, count, 5). */
int motions_possible(const real *motion, const real *things, const Body *body, int64_t n, int64_t count,
                     unsigned char *free, int64_t threads) {
  Rows rows = {motion, things, body, count, free};
  in_parallel(some_motions, &rows, n, 1024, (int)threads);
  return 0;
}
