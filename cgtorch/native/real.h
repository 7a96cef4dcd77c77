/* Vectors of 64 bytes of REAL, float or double, whatever registers the CPU has: sums of sixteen or
   eight parts are made in the same order everywhere, and a row never meets another one. */
#ifndef CGTORCH_REAL_H
#define CGTORCH_REAL_H
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef REAL real;
#define BYTES 64
#define WIDTH ((int)(BYTES / sizeof(real)))
typedef real vec __attribute__((vector_size(BYTES), aligned(8)));

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
typedef whole vwhole __attribute__((vector_size(BYTES), aligned(8)));

#define INLINE static inline __attribute__((always_inline))

INLINE vec load(const real *p) { vec v; memcpy(&v, p, BYTES); return v; }
INLINE void store(real *p, vec v) { memcpy(p, &v, BYTES); }
INLINE vec all(real x) { return x - (vec){0}; }
INLINE vec select_vec(vwhole yes, vec a, vec b) {
  return (vec)(((vwhole)a & yes) | ((vwhole)b & ~yes));
}
INLINE vec vec_max(vec a, vec b) { return select_vec(a > b, a, b); }
INLINE vec vec_min(vec a, vec b) { return select_vec(a < b, a, b); }

/* The sum and the least of a vector's parts, the first half with the second and so on. */
#ifdef REAL_IS_FLOAT
#define HALF(v) __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15, 0, 1, 2, 3, 4, 5, 6, 7)
#define QUARTER(v) __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11)
#define EIGHTH(v) __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13)
#define LAST(v) __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14)
#else
#define HALF(v) __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3)
#define QUARTER(v) __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5)
#define LAST(v) __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6)
#endif
INLINE real sum(vec v) {
  v += HALF(v);
  v += QUARTER(v);
#ifdef REAL_IS_FLOAT
  v += EIGHTH(v);
#endif
  v += LAST(v);
  return v[0];
}
INLINE real least(vec v) {
  v = vec_min(v, HALF(v));
  v = vec_min(v, QUARTER(v));
#ifdef REAL_IS_FLOAT
  v = vec_min(v, EIGHTH(v));
#endif
  v = vec_min(v, LAST(v));
  return v[0];
}

/* 2^x for x <= 0 to the last digit or two; what would be denormal is the smallest normal number. */
INLINE vec exp2_vec(vec x) {
  x = vec_max(x, all(SMALLEST));
  vec big = x + MAGIC, f = x - (big - MAGIC);
#ifdef REAL_IS_FLOAT /* near the best polynomial of its degree, 2.5e-9 off at most */
  vec p = all(0.00015461445f);
  p = p * f + 0.0013400428f;
  p = p * f + 0.009618057f;
  p = p * f + 0.055503272f;
  p = p * f + 0.24022651f;
  p = p * f + 0.6931472f;
  p = p * f + 1.0f;
#else /* Taylor's series */
  f = f * 0.69314718055994530942;
  vec p = all(1.0 / 6227020800.0);
  p = p * f + 1.0 / 479001600;
  p = p * f + 1.0 / 39916800;
  p = p * f + 1.0 / 3628800;
  p = p * f + 1.0 / 362880;
  p = p * f + 1.0 / 40320;
  p = p * f + 1.0 / 5040;
  p = p * f + 1.0 / 720;
  p = p * f + 1.0 / 120;
  p = p * f + 1.0 / 24;
  p = p * f + 1.0 / 6;
  p = p * f + 0.5;
  p = p * f + 1.0;
  p = p * f + 1.0;
#endif
  return (vec)((vwhole)p + ((vwhole)big << MANTISSA));
}

/* 1 / (1 + exp(-x)) of up to WIDTH numbers, in place; what is not a number stays so. */
INLINE void sigmoids(real *x, int count) {
  vec v = all(0);
  memcpy(&v, x, (size_t)count * sizeof(real));
  vec size = select_vec(v < 0, v, -v); /* -|x|, whose power of two is never large */
  vec power = exp2_vec(size * (real)1.44269504088896340736);
  vec p = select_vec(v < 0, power, all(1)) / (1 + power);
  p = select_vec(v == v, p, v);
  memcpy(x, &p, (size_t)count * sizeof(real));
}
#endif
