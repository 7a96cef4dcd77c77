/* RBF kernel matrices in single precision, from distances in double (cgtorch.svm.gram). */
#include "library.h"
#include "real.h"

#define FAINT 40 /* 2^-40 and less is 0: small numbers would slow down what is done with them */

typedef struct {
  const double *columns; /* (d, stride): sqrt(gamma log2 e) times the rows, filled up with zeros */
  int64_t n, d, stride;
  real *matrix; /* (n, stride) */
} Rows;

static void some_rows(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
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
  Rows rows = {columns, n, d, stride, matrix};
  in_parallel(some_rows, &rows, n, 16, threads);
  return 0;
}
