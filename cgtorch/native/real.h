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
/* On a CPU. */
#ifdef __AVX512DQ__
#include <immintrin.h>
#endif

#define UNROLLED _Pragma("GCC unroll 16") /* early, so that small arrays become registers */
/* `i` from 0 to `count`, which is `most` at most. */
#define UP_TO(i, count, most) for (int i = 0; i < (int)(count); i++)
#define MAKE(type) (type) /* what C and C++ write differently */
#define SET(flag) __atomic_store_n(flag, 1, __ATOMIC_RELAXED)
/* Long functions stay out of the loops that call them, whose registers they would take. */
#define APART static __attribute__((noinline))

#define BYTES 64
#define WIDTH ((int)(BYTES / sizeof(real)))
typedef real vec __attribute__((vector_size(BYTES), aligned(8)));

typedef whole vwhole __attribute__((vector_size(BYTES), aligned(8)));

INLINE vec load(const real *p) { vec v; memcpy(&v, p, BYTES); return v; }
INLINE void store(real *p, vec v) { memcpy(p, &v, BYTES); }
INLINE vec vec_of(real x) { return x - (vec){0}; }
INLINE vec as_numbers(vwhole x) { return __builtin_convertvector(x, vec); }
INLINE vwhole every(whole x) { return x - (vwhole){0}; }
INLINE vec select_vec(vwhole yes, vec a, vec b) {
  return (vec)(((vwhole)a & yes) | ((vwhole)b & ~yes));
}
INLINE vwhole select_whole(vwhole yes, vwhole a, vwhole b) { return (a & yes) | (b & ~yes); }

/* One instruction each, once a compiler has seen the loop. */
#define EACH(result, part)                           \
  do {                                               \
    _Pragma("omp simd") for (int i = 0; i < WIDTH; i++) result[i] = part; \
  } while (0)
/* The second of two where either is not a number. */
INLINE vec vec_max(vec a, vec b) { EACH(a, a[i] > b[i] ? a[i] : b[i]); return a; }
INLINE vec vec_min(vec a, vec b) { EACH(a, a[i] < b[i] ? a[i] : b[i]); return a; }
INLINE vec vec_sqrt(vec a) { EACH(a, FN(sqrt)(a[i])); return a; }
INLINE vec vec_floor(vec a) { EACH(a, FN(floor)(a[i])); return a; }
/* a b + c, rounded once. No compiler chooses where (-ffp-contract=off), so that all CPUs and GPUs make
   the same bits. */
#if defined(__x86_64__) && !defined(__FMA__)
#define FMA(a, b, c) ((a) * (b) + (c)) /* for CPUs of before 2013 libm's would take too long */
#else
#define FMA(a, b, c) FN(__builtin_fma)(a, b, c)
#endif
INLINE vec vec_fma(vec a, vec b, vec c) {
#if defined(__AVX512DQ__) && defined(REAL_IS_FLOAT)
  return (vec)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)c);
#elif defined(__AVX512DQ__)
  return (vec)_mm512_fmadd_pd((__m512d)a, (__m512d)b, (__m512d)c);
#else
  EACH(c, FMA(a[i], b[i], c[i]));
  return c;
#endif
}

/* A bit for each part of what a comparison gave. */
INLINE uint32_t bits_of(vwhole yes) {
#if defined(__AVX512DQ__) && defined(REAL_IS_FLOAT)
  return _mm512_movepi32_mask((__m512i)yes);
#elif defined(__AVX512DQ__)
  return _mm512_movepi64_mask((__m512i)yes);
#else
  uint32_t bits = 0;
  for (int i = 0; i < WIDTH; i++) bits |= (uint32_t)(yes[i] < 0) << i;
  return bits;
#endif
}

/* The sum and the least of a vector's parts, the first half with the second and so on; and those of
   four vectors at once, to the bit: their halves side by side, then quarters. */
#ifdef REAL_IS_FLOAT
#define HALF(v) __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15, 0, 1, 2, 3, 4, 5, 6, 7)
#define QUARTER(v) __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11)
#define EIGHTH(v) __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13)
#define WITH_EIGHTH(v, both) both(v, EIGHTH(v))
#define LAST(v) __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14)
#define LEFT_HALVES(a, b) \
  __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23)
#define RIGHT_HALVES(a, b) \
  __builtin_shufflevector(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31)
#define LEFT_QUARTERS(a, b) \
  __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27)
#define RIGHT_QUARTERS(a, b) \
  __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31)
#else
#define HALF(v) __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3)
#define QUARTER(v) __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5)
#define WITH_EIGHTH(v, both) (v)
#define LAST(v) __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6)
#define LEFT_HALVES(a, b) __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11)
#define RIGHT_HALVES(a, b) __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15)
#define LEFT_QUARTERS(a, b) __builtin_shufflevector(a, b, 0, 1, 4, 5, 8, 9, 12, 13)
#define RIGHT_QUARTERS(a, b) __builtin_shufflevector(a, b, 2, 3, 6, 7, 10, 11, 14, 15)
#endif
#define REDUCTIONS(of_one, of_four, both)                           \
  INLINE real of_one(vec v) {                                       \
    v = both(v, HALF(v));                                           \
    v = both(v, QUARTER(v));                                        \
    v = WITH_EIGHTH(v, both);                                       \
    v = both(v, LAST(v));                                           \
    return v[0];                                                    \
  }                                                                 \
  INLINE void of_four(const vec *v, real *out) {                    \
    vec ab = both(LEFT_HALVES(v[0], v[1]), RIGHT_HALVES(v[0], v[1])); \
    vec cd = both(LEFT_HALVES(v[2], v[3]), RIGHT_HALVES(v[2], v[3])); \
    vec all4 = both(LEFT_QUARTERS(ab, cd), RIGHT_QUARTERS(ab, cd)); \
    all4 = WITH_EIGHTH(all4, both);                                 \
    all4 = both(all4, LAST(all4));                                  \
    for (int r = 0; r < 4; r++) out[r] = all4[r * WIDTH / 4];       \
  }
INLINE vec vec_sum(vec a, vec b) { return a + b; }
REDUCTIONS(sum, sums, vec_sum)
REDUCTIONS(least, leasts, vec_min)

/* The first of some lanes, and whether there are any, also of those that are asked together. */
INLINE int first_of(uint32_t bits) { return __builtin_ctz(bits); }
INLINE int any_of(uint32_t bits) { return bits != 0; }
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
