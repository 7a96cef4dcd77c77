/* Vectors of 64 bytes of REAL, float or double, for any registers of the CPU: sums of sixteen or eight parts
   have the same order everywhere, and rows are independent. On a GPU, a vector is one thread's number
   (cuda/lane.h). */
#pragma once
#ifdef __CUDACC_RTC__
#include "cuda/types.h"
#else
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#endif

typedef REAL real;
#ifdef REAL_IS_FLOAT
typedef int32_t whole;
#define FN(name) name##f
#define MAGIC 12582912.0f /* 1.5 * 2^23: adding it rounds to a whole number */
#define MANTISSA 23
#define SMALLEST -126.0f
#else
typedef int64_t whole;
#define FN(name) name
#define MAGIC 6755399441055744.0 /* 1.5 * 2^52 */
#define MANTISSA 52
#define SMALLEST -1022.0
#endif

#define INLINE static inline __attribute__((always_inline))

#ifdef __cplusplus
#include "cuda/lane.h"
#else
#include "vector.h"
#endif

INLINE vec vec_abs(vec a) { return (vec)((vwhole)a & ~(vwhole)vec_of((real)-0.0)); }
INLINE vec with_sign_of(vec a, vec b) {
  return (vec)((vwhole)a | ((vwhole)b & (vwhole)vec_of((real)-0.0)));
}
INLINE vwhole finite_vec(vec a) { return a * 0 == 0; }

/* 2^-x for x >= 0 to the last digit or two; denormal results become the smallest normal number, and NaN stays
   NaN. For float it is near the best polynomial of its degree, 2.5e-9 off at most; for double a Taylor
   series. */
#ifdef REAL_IS_FLOAT
#define UNIT 1
static const real POWERS[] = {0.00015461445f, -0.0013400428f, 0.009618057f, -0.055503272f,
                              0.24022651f,    -0.6931472f,    1.0f};
#else
#define UNIT 0.69314718055994530942
static const real POWERS[] = {-1.0 / 6227020800, 1.0 / 479001600, -1.0 / 39916800, 1.0 / 3628800,
                              -1.0 / 362880,     1.0 / 40320,     -1.0 / 5040,     1.0 / 720,
                              -1.0 / 120,        1.0 / 24,        -1.0 / 6,        0.5,
                              -1.0,              1.0};
#endif
#define EXP2_TERMS (int)(sizeof POWERS / sizeof *POWERS)

/* For `count` vectors in place, step by step together, so that no step waits for the one before. */
INLINE void exp2_minus(vec *x, int count) {
  vec big[4], p[4];
  UNROLLED for (int r = 0; r < count; r++) {
    x[r] = vec_min(x[r], vec_of(-SMALLEST));
    big[r] = MAGIC - x[r];
    x[r] = (x[r] + (big[r] - MAGIC)) * UNIT;
    p[r] = vec_of(POWERS[0]);
  }
  UNROLLED for (int i = 1; i < EXP2_TERMS; i++)
    UNROLLED for (int r = 0; r < count; r++) p[r] = vec_fma(p[r], x[r], vec_of(POWERS[i]));
  UNROLLED for (int r = 0; r < count; r++)
    x[r] = (vec)((vwhole)p[r] + ((vwhole)big[r] << MANTISSA));
}
INLINE vec exp2_vec(vec x) {
  x = -x;
  exp2_minus(&x, 1);
  return x;
}

/* 1 / (1 + exp(-x)); NaN stays NaN. */
INLINE vec sigmoid_vec(vec x) {
  vec power = exp2_vec(vec_abs(x) * (real)-1.44269504088896340736); /* never large */
  vec p = select_vec(x < 0, power, vec_of(1)) / (1 + power);
  return select_vec(x == x, p, x);
}
