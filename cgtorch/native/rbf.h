/* The function of an RBF machine: sum_j w_j exp(-gamma |x - c_j|^2) + bias. */
#ifndef CGTORCH_RBF_H
#define CGTORCH_RBF_H
#include "real.h"

typedef struct {
  const real *centres; /* (d, m) sqrt(gamma log2 e) times the centres, m filled up to WIDTH */
  const real *weights; /* (k, m), 0 where filled up */
  const real *bias;    /* (k,) */
  real scale;          /* sqrt(gamma log2 e) */
  int64_t m, d, k;
} Machine;

#define MOST_FEATURES 64
#define MOST_OUTPUTS 16
#define TILE 4 /* rows that share what is loaded of the centres */
#define SMALL_TILE 2

/* Values (rows, k) and squared scaled distances (rows,) to the nearest centre of `rows` rows, TILE
   at most. Each row's numbers are made by the same steps in the same order however many come. */
INLINE void machine_rows(const Machine *f, const real *x, int rows, int outputs, int features,
                         real *values, real *nearest) {
  real at[TILE][MOST_FEATURES];
  vec total[TILE][MOST_OUTPUTS], near[TILE];
  for (int r = 0; r < rows; r++) {
    for (int i = 0; i < features; i++) at[r][i] = x[r * features + i] * f->scale;
    for (int o = 0; o < outputs; o++) total[r][o] = all(0);
    near[r] = all((real)INFINITY);
  }
  for (int64_t j = 0; j < f->m; j += WIDTH) {
    vec distance[TILE];
    for (int r = 0; r < rows; r++) distance[r] = all(0);
    for (int i = 0; i < features; i++) {
      vec c = load(f->centres + i * f->m + j);
      for (int r = 0; r < rows; r++) {
        vec gap = at[r][i] - c;
        distance[r] += gap * gap;
      }
    }
    for (int r = 0; r < rows; r++) {
      near[r] = vec_min(near[r], distance[r]);
      distance[r] = exp2_vec(-distance[r]);
    }
    for (int o = 0; o < outputs; o++) {
      vec w = load(f->weights + o * f->m + j);
      for (int r = 0; r < rows; r++) total[r][o] += w * distance[r];
    }
  }
  for (int r = 0; r < rows; r++) {
    int finite = 1;
    for (int i = 0; i < features; i++) finite &= isfinite(x[r * features + i]) != 0;
    for (int o = 0; o < outputs; o++)
      values[r * outputs + o] = finite ? sum(total[r][o]) + f->bias[o] : (real)NAN;
    nearest[r] = finite ? least(near[r]) : (real)NAN;
  }
}

#endif
