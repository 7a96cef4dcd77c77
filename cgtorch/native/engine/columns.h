/* Copying short rows of numbers, and transposing them to columns of vectors. */
#pragma once
#include "real.h"

/* One of two vectors whose numbers change places where bit B of their index says so: of rows and
   columns of a square that are 2^B apart, the two squares beside its diagonal. */
#define KEPT(j, B) ((j) >> (B) & 1 ? WIDTH + ((j) ^ (1 << (B))) : (j))
#define GIVEN(j, B) ((j) >> (B) & 1 ? WIDTH + (j) : ((j) ^ (1 << (B))))
#ifdef REAL_IS_FLOAT
#define SHUFFLED(a, b, which, B)                                                                   \
  __builtin_shufflevector(a, b, which(0, B), which(1, B), which(2, B), which(3, B), which(4, B),   \
                          which(5, B), which(6, B), which(7, B), which(8, B), which(9, B),         \
                          which(10, B), which(11, B), which(12, B), which(13, B), which(14, B),    \
                          which(15, B))
#else
#define SHUFFLED(a, b, which, B)                                                                   \
  __builtin_shufflevector(a, b, which(0, B), which(1, B), which(2, B), which(3, B), which(4, B),   \
                          which(5, B), which(6, B), which(7, B))
#endif
#define SWAPPED(v, rows, B)                                    \
  UNROLLED for (int r = 0; r < (rows); r++) {                  \
    if (r >> (B) & 1) continue;                                \
    vec low = v[r], high = v[r + (1 << (B))];                  \
    v[r] = SHUFFLED(low, high, KEPT, B);                       \
    v[r + (1 << (B))] = SHUFFLED(low, high, GIVEN, B);         \
  }

/* Of two halves of vectors, each a square of its own, rows become columns. */
INLINE void transpose_halves(vec *v, int rows) {
  SWAPPED(v, rows, 0)
  SWAPPED(v, rows, 1)
#ifdef REAL_IS_FLOAT
  SWAPPED(v, rows, 2)
#endif
}
INLINE void transpose(vec *v) {
  transpose_halves(v, WIDTH);
#ifdef REAL_IS_FLOAT
  SWAPPED(v, WIDTH, 3)
#else
  SWAPPED(v, WIDTH, 2)
#endif
}

#ifdef __AVX512DQ__
#define HALF_WIDTH (WIDTH / 2)
/* Up to half a vector's numbers of two rows, side by side. */
INLINE vec load_two(const real *a, const real *b, int count) {
#ifdef REAL_IS_FLOAT
  __mmask8 part = (__mmask8)((1u << count) - 1);
  return (vec)_mm512_insertf32x8(_mm512_castps256_ps512(_mm256_maskz_loadu_ps(part, a)),
                                 _mm256_maskz_loadu_ps(part, b), 1);
#else
  __mmask8 part = (__mmask8)((1u << count) - 1);
  return (vec)_mm512_insertf64x4(_mm512_castpd256_pd512(_mm256_maskz_loadu_pd(part, a)),
                                 _mm256_maskz_loadu_pd(part, b), 1);
#endif
}
#endif

/* `count` numbers of each of WIDTH rows. */
INLINE void into_columns_of(const real *const *rows, int count, vec *columns) {
  int j = 0;
  for (; j + WIDTH <= count; j += WIDTH) {
    vec square[WIDTH];
    UNROLLED for (int i = 0; i < WIDTH; i++) square[i] = load(rows[i] + j);
    transpose(square);
    UNROLLED for (int i = 0; i < WIDTH; i++) columns[j + i] = square[i];
  }
#ifdef __AVX512DQ__
  for (; j < count; j += HALF_WIDTH) {
    vec halves[WIDTH / 2];
    int here = count - j < HALF_WIDTH ? count - j : HALF_WIDTH;
    UNROLLED for (int i = 0; i < HALF_WIDTH; i++)
      halves[i] = load_two(rows[i] + j, rows[i + HALF_WIDTH] + j, here);
    transpose_halves(halves, HALF_WIDTH);
    for (int i = 0; i < here; i++) columns[j + i] = halves[i];
  }
#else
  for (; j < count; j++)
    for (int i = 0; i < WIDTH; i++) columns[j][i] = rows[i][j];
#endif
}

/* Copies a row; returns whether any number differs. */
INLINE int copied_row(const real *from, real *to, int64_t size) {
  int other = 0;
#ifdef __AVX512DQ__ /* which needs no loop for what is not a whole vector */
  for (int64_t j = 0; j < size; j += WIDTH) {
    uint32_t part = size - j < WIDTH ? (1u << (size - j)) - 1 : (uint32_t)((1ull << WIDTH) - 1);
#ifdef REAL_IS_FLOAT
    __m512 now = _mm512_maskz_loadu_ps((__mmask16)part, from + j);
    other |= _mm512_mask_cmp_ps_mask((__mmask16)part, now,
                                     _mm512_maskz_loadu_ps((__mmask16)part, to + j), _CMP_NEQ_UQ);
    _mm512_mask_storeu_ps(to + j, (__mmask16)part, now);
#else
    __m512d now = _mm512_maskz_loadu_pd((__mmask8)part, from + j);
    other |= _mm512_mask_cmp_pd_mask((__mmask8)part, now,
                                     _mm512_maskz_loadu_pd((__mmask8)part, to + j), _CMP_NEQ_UQ);
    _mm512_mask_storeu_pd(to + j, (__mmask8)part, now);
#endif
  }
#else
  for (int64_t j = 0; j < size; j++) other |= to[j] != from[j], to[j] = from[j];
#endif
  return other != 0;
}
