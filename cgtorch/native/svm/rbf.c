/* Values of RBF machines for many rows, and kernel matrices (cgtorch.svm.rbf). */
#include "library.h"
#include "rbf.h"

EXPORT_STRUCT(Machine)
EXPORT_CONSTANTS(machine_limits, MOST_FEATURES, MOST_OUTPUTS)
EXPORT_CONSTANTS(blocks, BLOCK_BYTES)

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

#define FAINT 40 /* 2^-40 and less is 0, as small numbers would slow down later operations */

/* In single precision, from distances in double. */
typedef struct {
  const double *columns; /* (d, stride): sqrt(gamma log2 e) times the rows, filled up with zeros */
  int64_t n, d, stride;
  real *matrix; /* (n, stride) */
} Pairs;

static void matrix_rows(void *what, int64_t begin, int64_t end) {
  const Pairs *r = what;
  for (int64_t i = begin; i < end; i++)
    for (int64_t b = 0; b < r->stride; b += WIDTH) {
      double distance[WIDTH] = {0};
      for (int64_t k = 0; k < r->d; k++) {
        const double *column = r->columns + k * r->stride;
        double own = column[i];
        for (int e = 0; e < WIDTH; e++) {
          double gap = own - column[b + e];
          distance[e] = __builtin_fma(gap, gap, distance[e]);
        }
      }
      vec power;
      for (int e = 0; e < WIDTH; e++) power[e] = (real)-distance[e];
      vec value = select_vec(power > -FAINT, exp2_vec(power), vec_of(0));
      store(r->matrix + i * r->stride + b, value);
    }
}

/* The matrix (n, stride), whose columns from n on are of no row. */
int rbf_gram(const double *columns, int64_t n, int64_t d, int64_t stride, real *matrix,
             int64_t threads) {
  Pairs rows = {columns, n, d, stride, matrix};
  in_parallel(matrix_rows, &rows, n, 16, threads);
  return 0;
}
