/* Vectors of REAL, float or double, that fill the CPU's registers. Numbers are added up in blocks of 64 bytes,
   which are one vector or two, so that sums of sixteen or eight parts have the same order everywhere; rows are
   independent. On a GPU, a vector is one thread's number (cuda/lane.h). */
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

#define BLOCK_BYTES 64
#define BLOCK ((int)(BLOCK_BYTES / sizeof(real)))
#ifdef __AVX512DQ__
#define BYTES 64
#else
#define BYTES 32
#endif
#define VECTORS (BLOCK_BYTES / BYTES)
#ifdef REAL_IS_FLOAT
#define WIDTH (BYTES / 4)
#else
#define WIDTH (BYTES / 8)
#endif
typedef real vec __attribute__((vector_size(BYTES), aligned(8)));

typedef whole vwhole __attribute__((vector_size(BYTES), aligned(8)));

/* GCC would copy the halves of 32 bytes by memcpy through memory, and wait for them. */
typedef real unaligned __attribute__((vector_size(BYTES), aligned(sizeof(real)), may_alias));
INLINE vec load(const real *p) { return *(const unaligned *)p; }
INLINE void store(real *p, vec v) { *(unaligned *)p = v; }
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
#elif defined(__AVX2__) && defined(REAL_IS_FLOAT)
  return (uint32_t)__builtin_ia32_movmskps256((float __attribute__((vector_size(32))))yes);
#elif defined(__AVX2__)
  return (uint32_t)__builtin_ia32_movmskpd256((double __attribute__((vector_size(32))))yes);
#else
  uint32_t bits = 0;
  for (int i = 0; i < WIDTH; i++) bits |= (uint32_t)(yes[i] < 0) << i;
  return bits;
#endif
}

/* Two vectors' numbers j in another order, and that with a piece of s numbers and its neighbour exchanged, or
   all even or odd pieces. */
#if WIDTH == 16
#define SHUFFLED(a, b, from, s)                                                                      \
  __builtin_shufflevector(a, b, from(0, s), from(1, s), from(2, s), from(3, s), from(4, s), from(5, s), \
                          from(6, s), from(7, s), from(8, s), from(9, s), from(10, s), from(11, s),   \
                          from(12, s), from(13, s), from(14, s), from(15, s))
#elif WIDTH == 8
#define SHUFFLED(a, b, from, s)                                                                      \
  __builtin_shufflevector(a, b, from(0, s), from(1, s), from(2, s), from(3, s), from(4, s), from(5, s), \
                          from(6, s), from(7, s))
#else
#define SHUFFLED(a, b, from, s) \
  __builtin_shufflevector(a, b, from(0, s), from(1, s), from(2, s), from(3, s))
#endif
#define EXCHANGED(j, s) ((j) ^ (s))
#define EVEN(j, s) ((j) / (s) * 2 * (s) + (j) % (s))
#define ODD(j, s) (EVEN(j, s) + (s))

/* The sum and the least of a vector's parts, the first half with the second and so on; and those of
   four blocks at once, to the bit: their halves side by side, then quarters. */
#define REDUCTIONS(of_vector, of_four, both)                                            \
  INLINE real of_vector(vec v) {                                                        \
    if (WIDTH > 8) v = both(v, SHUFFLED(v, v, EXCHANGED, 8 % WIDTH));                   \
    if (WIDTH > 4) v = both(v, SHUFFLED(v, v, EXCHANGED, 4));                           \
    v = both(v, SHUFFLED(v, v, EXCHANGED, 2));                                          \
    v = both(v, SHUFFLED(v, v, EXCHANGED, 1));                                          \
    return v[0];                                                                        \
  }                                                                                     \
  INLINE void of_four(const vec (*block)[VECTORS], real *out) {                         \
    vec v[4];                                                                           \
    for (int r = 0; r < 4; r++)                                                         \
      v[r] = VECTORS > 1 ? both(block[r][0], block[r][VECTORS - 1]) : block[r][0];      \
    vec ab = both(SHUFFLED(v[0], v[1], EVEN, WIDTH / 2), SHUFFLED(v[0], v[1], ODD, WIDTH / 2)); \
    vec cd = both(SHUFFLED(v[2], v[3], EVEN, WIDTH / 2), SHUFFLED(v[2], v[3], ODD, WIDTH / 2)); \
    vec all4 = both(SHUFFLED(ab, cd, EVEN, WIDTH / 4), SHUFFLED(ab, cd, ODD, WIDTH / 4)); \
    if (WIDTH > 8) all4 = both(all4, SHUFFLED(all4, all4, EXCHANGED, 2));               \
    if (WIDTH > 4) all4 = both(all4, SHUFFLED(all4, all4, EXCHANGED, 1));               \
    for (int r = 0; r < 4; r++) out[r] = all4[r * WIDTH / 4];                           \
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
