/* The function of an RBF machine: sum_j w_j exp(-gamma |x - c_j|^2) + bias. */
#pragma once
#include "real.h"

typedef struct {
  const real *centres; /* (d, m) sqrt(gamma log2 e) times the centres, m filled up to BLOCK */
  const real *weights; /* (k, m), 0 where filled up */
  const real *bias;    /* (k,) */
  real scale;          /* sqrt(gamma log2 e) */
  int64_t m, d, k;
} Machine;

#ifndef MOST_FEATURES
#define MOST_FEATURES 64
#define MOST_OUTPUTS 16
#endif

#ifdef __cplusplus
#include "cuda/machine.h"
#else
#define TILE 4 /* rows that share what is loaded of the centres */
#define SMALL_TILE 2

/* Values (outputs, TILE), without bias, and squared scaled distances (TILE,) to the nearest centre of
   `rows` rows that are scaled, TILE at most. Each row's numbers are made by the same steps in the same
   order however many come. */
INLINE void machine_tile(const Machine *f, const real at[TILE][MOST_FEATURES], int rows, int outputs,
                         int features, real (*values)[TILE], real *nearest) {
  vec total[MOST_OUTPUTS][TILE][VECTORS], near[TILE][VECTORS];
  UNROLLED for (int r = 0; r < TILE; r++) UNROLLED for (int v = 0; v < VECTORS; v++) {
    for (int o = 0; o < outputs; o++) total[o][r][v] = vec_of(0);
    near[r][v] = vec_of((real)INFINITY);
  }
  for (int64_t block = 0; block < f->m; block += BLOCK) UNROLLED for (int v = 0; v < VECTORS; v++) {
    int64_t j = block + v * WIDTH;
    vec distance[TILE];
    UNROLLED for (int r = 0; r < rows; r++) distance[r] = vec_of(0);
    for (int i = 0; i < features; i++) {
      vec c = load(f->centres + i * f->m + j);
      UNROLLED for (int r = 0; r < rows; r++) {
        vec gap = at[r][i] - c;
        distance[r] = vec_fma(gap, gap, distance[r]);
      }
    }
    UNROLLED for (int r = 0; r < rows; r++) near[r][v] = vec_min(near[r][v], distance[r]);
    exp2_minus(distance, rows);
    for (int o = 0; o < outputs; o++) {
      vec w = load(f->weights + o * f->m + j);
      UNROLLED for (int r = 0; r < rows; r++) total[o][r][v] = vec_fma(w, distance[r], total[o][r][v]);
    }
  }
  for (int o = 0; o < outputs; o++) sums(total[o], values[o]);
  leasts(near, nearest);
}

/* Values (rows, k) and squared scaled distances (rows,) to the nearest centre of rows x (rows, d). */
INLINE void machine_rows(const Machine *f, const real *x, int rows, int outputs, int features,
                         real *values, real *nearest) {
  real at[TILE][MOST_FEATURES], found[MOST_OUTPUTS][TILE], near[TILE];
  for (int r = 0; r < rows; r++)
    for (int i = 0; i < features; i++) at[r][i] = x[r * features + i] * f->scale;
  machine_tile(f, at, rows, outputs, features, found, near);
  for (int r = 0; r < rows; r++) {
    int finite = 1;
    for (int i = 0; i < features; i++) finite &= isfinite(x[r * features + i]) != 0;
    for (int o = 0; o < outputs; o++)
      values[r * outputs + o] = finite ? found[o][r] + f->bias[o] : (real)NAN;
    nearest[r] = finite ? near[r] : (real)NAN;
  }
}

/* The same for those of a vector's rows that `bits` has; x (d,), values (outputs,). */
INLINE void tile_of_lanes(const Machine *f, const vec *x, const int *lanes, int rows, int outputs,
                          int features, vec *values, vec *nearest) {
  real at[TILE][MOST_FEATURES], found[MOST_OUTPUTS][TILE], near[TILE];
  for (int r = 0; r < rows; r++)
    for (int i = 0; i < features; i++) at[r][i] = x[i][lanes[r]];
  machine_tile(f, at, rows, outputs, features, found, near);
  for (int r = 0; r < rows; r++) {
    for (int o = 0; o < outputs; o++) values[o][lanes[r]] = found[o][r];
    (*nearest)[lanes[r]] = near[r];
  }
}
INLINE void lanes_of_outputs(const Machine *f, const vec *x, uint32_t bits, int outputs, int features,
                             vec *values, vec *nearest) {
  vec scaled[MOST_FEATURES];
  vwhole finite = every(-1);
  int lanes[WIDTH], count = 0, i = 0;
  for (; bits; bits &= bits - 1) lanes[count++] = first_of(bits);
  for (int k = 0; k < features; k++) scaled[k] = x[k] * f->scale, finite &= finite_vec(x[k]);
  for (int o = 0; o < outputs; o++) values[o] = vec_of(0);
  *nearest = vec_of(0);
  for (; i + TILE <= count; i += TILE)
    tile_of_lanes(f, scaled, lanes + i, TILE, outputs, features, values, nearest);
  for (; i < count; i++)
    tile_of_lanes(f, scaled, lanes + i, 1, outputs, features, values, nearest);
  for (int o = 0; o < outputs; o++)
    values[o] = select_vec(finite, values[o] + f->bias[o], vec_of((real)NAN));
  *nearest = select_vec(finite, *nearest, vec_of((real)NAN));
}
#endif

INLINE void machine_lanes(const Machine *f, const vec *x, uint32_t bits, int features, vec *value,
                          vec *nearest) {
  lanes_of_outputs(f, x, bits, 1, features, value, nearest);
}
/* With the number of outputs known, what is added up for them stays in registers. */
INLINE void machine_outputs(const Machine *f, const vec *x, uint32_t bits, vec *values, vec *nearest) {
  int features = (int)f->d;
  switch (f->k) {
  case 1: lanes_of_outputs(f, x, bits, 1, features, values, nearest); break;
  case 2: lanes_of_outputs(f, x, bits, 2, features, values, nearest); break;
  case 3: lanes_of_outputs(f, x, bits, 3, features, values, nearest); break;
  case 4: lanes_of_outputs(f, x, bits, 4, features, values, nearest); break;
  default: lanes_of_outputs(f, x, bits, (int)f->k, features, values, nearest);
  }
}
