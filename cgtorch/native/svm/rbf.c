/* Values of RBF machines for many rows (cgtorch.svm.rbf_predict). */
#include "library.h"
#include "rbf.h"

EXPORT_STRUCT(Machine)
EXPORT_CONSTANTS(machine_limits, MOST_FEATURES, MOST_OUTPUTS)
EXPORT_CONSTANTS(vector, BYTES)

typedef struct {
  Machine f;
  const real *x;
  real *values, *nearest;
} Rows;

/* As many rows at once as keep their sums in registers. */
INLINE void tiles(const Rows *rows, int64_t begin, int64_t end, int outputs, int features) {
  int tile = outputs <= 2 ? TILE : SMALL_TILE;
  int64_t i = begin;
  for (; i + tile <= end; i += tile)
    machine_rows(&rows->f, rows->x + i * features, tile, outputs, features,
                 rows->values + i * outputs, rows->nearest + i);
  for (; i < end; i++)
    machine_rows(&rows->f, rows->x + i * features, 1, outputs, features,
                 rows->values + i * outputs, rows->nearest + i);
}

static void some_rows(void *what, int64_t begin, int64_t end) {
  const Rows *rows = what;
  int d = (int)rows->f.d, k = (int)rows->f.k;
  if (k == 1 && d == 4) tiles(rows, begin, end, 1, 4);
  else if (k == 1 && d == 7) tiles(rows, begin, end, 1, 7);
  else if (k == 1 && d == 8) tiles(rows, begin, end, 1, 8);
  else if (k == 1) tiles(rows, begin, end, 1, d);
  else if (k == 7 && d == 10) tiles(rows, begin, end, 7, 10);
  else if (k == 7) tiles(rows, begin, end, 7, d);
  else tiles(rows, begin, end, k, d);
}

/* Values (n, k) and scaled squared distances (n,) to the nearest centre of rows x (n, d). */
int rbf_values(const Machine *machine, const real *x, int64_t n, real *values, real *nearest,
               int64_t threads) {
  Rows rows = {*machine, x, values, nearest};
  in_parallel(some_rows, &rows, n, 256, threads);
  return 0;
}
