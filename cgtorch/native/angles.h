/* Angles of the rows of a vector: sines, cosines and arc tangents to the last digit or two, half angles,
   wrapping. Mathematical libraries are not used, as they differ in last digits. */
#pragma once
#include "real.h"

#define PI 3.14159265358979323846

/* pi/2 in parts of few digits, whose products with whole numbers up to MOST_TURNED are exact (Cody & Waite);
   polynomials of Cephes (float) and fdlibm (double) on [-pi/4, pi/4]. */
#ifdef REAL_IS_FLOAT
#define MOST_TURNED 8192
static const real QUARTER_TURN[] = {1.5703125f, 4.837512969970703125e-4f, 7.54978995489188216e-8f};
static const real SINE[] = {-1.9515295891e-4f, 8.3321608736e-3f, -1.6666654611e-1f};
static const real COSINE[] = {2.443315711809948e-5f, -1.388731625493765e-3f, 4.166664568298827e-2f};
#else
#define MOST_TURNED 100000
static const real QUARTER_TURN[] = {1.57079632673412561417e+00, 6.07710050630396597660e-11,
                                    2.02226624879595063154e-21};
static const real SINE[] = {1.58969099521155010221e-10, -2.50507602534068634195e-08,
                            2.75573137070700676789e-06, -1.98412698298579493134e-04,
                            8.33333333332248946124e-03, -1.66666666666666324348e-01};
static const real COSINE[] = {-1.13596475577881948265e-11, 2.08757232129817482790e-09,
                              -2.75573143513906633035e-07, 2.48015872894767294178e-05,
                              -1.38888888888741095749e-03, 4.16666666666666019037e-02};
#endif
#define TERMS (int)(sizeof SINE / sizeof *SINE)
#define SIGN_BIT (8 * (int)sizeof(real) - 1)

/* 2 / pi behind 64 zeros, in words of 32 bits. */
static const uint32_t TWO_BY_PI[] = {
    0,          0,          0xA2F9836E, 0x4E441529, 0xFC2757D1, 0xF534DDC0, 0xDB629599, 0x3C439041,
    0xFE5163AB, 0xDEBBC561, 0xB7246E3A, 0x424DD2E0, 0x06492EEA, 0x09D1921C, 0xFE1DEB1C, 0xB129A73E,
    0xE88235F5, 0x2EBB4484, 0xE99C7026, 0xB45F7E41, 0x3991D639, 0x835339F4, 0x9C845F8B, 0xBDF9283B,
    0x1FF897FF, 0xDE05980F, 0xEF2F118B, 0x5A0A6D1F, 0x6D367ECF, 0x27CB09B7, 0x4F463F66, 0x9E5FEA2D,
    0x7527BAC7, 0xEBE5F17B, 0x3D0739F7, 0x8A5292EA, 0x6BFB5FB1, 0x1F8D5D08, 0x56033046, 0xFC7B6BAB};
#define WORDS 6 /* of 2 / pi that count for one number: 2 bits before the point, and as many as its digits
                   need twice behind it */

/* The number of quarter turns nearest to a large angle, and the remainder, computed with integers (Payne &
   Hanek, "Radian reduction for trigonometric functions", 1983). */
static real reduced(real angle, whole *turns) {
  uint64_t digits, carry = 0;
  whole bits;
  memcpy(&bits, &angle, sizeof bits);
  if (!(angle * 0 == 0)) return angle * 0;
  digits = (uint64_t)((bits & (((whole)1 << MANTISSA) - 1)) | (whole)1 << MANTISSA);
  int exponent = (int)(bits >> MANTISSA & ((1 << (SIGN_BIT - MANTISSA)) - 1));
  int from = 64 - 2 + exponent + (int)SMALLEST - 1 - MANTISSA; /* the first bit that is worth 2 at most */
  uint32_t part[WORDS], product[WORDS];
  for (int j = 0; j < WORDS; j++) {
    const uint32_t *at = TWO_BY_PI + (from >> 5) + j;
    part[j] = (uint32_t)(((uint64_t)at[0] << 32 | at[1]) >> (32 - (from & 31)));
  }
  for (int j = WORDS - 1; j >= 0; j--) {
    carry += part[j] * (digits & 0xFFFFFFFF);
    product[j] = (uint32_t)carry;
    carry >>= 32;
  }
  carry = 0;
  for (int j = WORDS - 2; j >= 0; j--) {
    carry += product[j] + part[j + 1] * (digits >> 32);
    product[j] = (uint32_t)carry;
    carry >>= 32;
  }
  uint64_t high = (uint64_t)product[0] << 32 | product[1], low = (uint64_t)product[2] << 32 | product[3];
  int64_t beyond = (int64_t)(high << 2 | low >> 62); /* of the nearest turn, by its sign */
  real rest = (real)beyond * (real)0x1p-64 + (real)(low << 2) * (real)0x1p-128;
  *turns = (whole)(high >> 62) + (beyond < 0);
  rest *= (real)(PI / 2);
  if (angle < 0) *turns = -*turns, rest = -rest;
  return rest;
}

INLINE void sine_cosine(vec x, vec *s, vec *c) {
  vec big = x * (real)(2 / PI) + MAGIC, n = big - MAGIC, r = x;
  for (int i = 0; i < 3; i++) r = vec_fma(-n, vec_of(QUARTER_TURN[i]), r);
  vwhole turns = (vwhole)big, far = ~(vec_abs(x) <= MOST_TURNED);
  if (__builtin_expect(bits_of(far) != 0, 0))
    for (int i = 0; i < WIDTH; i++)
      if (far[i]) {
        whole whole_turns = 0;
        r[i] = reduced(x[i], &whole_turns);
        turns[i] = whole_turns;
      }
  vec z = r * r, sine = vec_of(SINE[0]), cosine = vec_of(COSINE[0]);
  for (int i = 1; i < TERMS; i++) {
    sine = vec_fma(sine, z, vec_of(SINE[i]));
    cosine = vec_fma(cosine, z, vec_of(COSINE[i]));
  }
  sine = vec_fma(sine * z, r, r);
  cosine = vec_fma(cosine * z, z, 1 - z / 2);
  vwhole odd = (turns & 1) != 0;
  *s = (vec)((vwhole)select_vec(odd, cosine, sine) ^ (turns >> 1 << SIGN_BIT));
  *c = (vec)((vwhole)select_vec(odd, sine, cosine) ^ ((turns + 1) >> 1 << SIGN_BIT));
}

/* Cephes' arc tangents on [0, tan(pi / 8)]: x + x^3 p(x^2), for double a fraction. */
#ifdef REAL_IS_FLOAT
static const real ARC[] = {8.05374449538e-2f, -1.38776856032e-1f, 1.99777106478e-1f, -3.33329491539e-1f};
#else
static const real ARC[] = {-8.750608600031904122785e-1, -1.615753718733365076637e1,
                           -7.500855792314704667340e1, -1.228866684490136173410e2,
                           -6.485021904942025371773e1};
static const real BELOW[] = {1.0, 2.485846490142306297962e1, 1.650270098316988542046e2,
                             4.328810604912902668951e2, 4.853903996359136964868e2,
                             1.945506571482613964425e2};
#endif
INLINE vec polynomial(const real *factors, int count, vec z) {
  vec p = vec_of(factors[0]);
  for (int i = 1; i < count; i++) p = vec_fma(p, z, vec_of(factors[i]));
  return p;
}
/* The angle of (x, y), to the last digit or two; NaN if either is not finite. */
INLINE vec atan2_vec(vec y, vec x) {
  vec ax = vec_abs(x), ay = vec_abs(y), less = vec_min(ax, ay), more = vec_max(ax, ay);
  vwhole steep = less > (real)0.41421356237309504880 * more;
  vec t = select_vec(steep, less - more, less) / select_vec(steep, less + more, more);
  t = select_vec(more == 0, vec_of(0), t);
  vec z = t * t, p = polynomial(ARC, (int)(sizeof ARC / sizeof *ARC), z);
#ifndef REAL_IS_FLOAT
  p = p / polynomial(BELOW, (int)(sizeof BELOW / sizeof *BELOW), z);
#endif
  vec angle = vec_fma(t * z, p, t) + select_vec(steep, vec_of((real)(PI / 4)), vec_of(0));
  angle = select_vec(ay > ax, (real)(PI / 2) - angle, angle);
  angle = select_vec((vwhole)x < 0, (real)PI - angle, angle) + ((x - x) + (y - y));
  return with_sign_of(angle, y);
}
INLINE vec wrap(vec angle) {
  return angle - (real)(2 * PI) * vec_floor((angle + (real)PI) / (real)(2 * PI));
}
/* Cosine and sine of half the angle of (x, y), in [-pi/2, pi/2]. */
INLINE void half_angle(vec x, vec y, vec *c, vec *s) {
  vec size = vec_sqrt(x * x + y * y), share = select_vec(size == 0, vec_of(1), x / size);
  vec larger = vec_sqrt((1 + vec_abs(share)) / 2);
  vec smaller = select_vec(size == 0, vec_of(0), vec_abs(y) / (2 * size * larger));
  *c = select_vec(share >= 0, larger, smaller);
  *s = with_sign_of(select_vec(share >= 0, smaller, larger), y);
}
