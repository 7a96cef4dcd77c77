/* Angles of a vector's rows: sines and cosines to the last digit or two, half angles, wrapping. */
#pragma once
#include "real.h"

#define PI 3.14159265358979323846

/* pi/2 in parts of few digits, which whole numbers up to MOST_TURNED multiply exactly (Cody & Waite);
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
#define TERMS (sizeof SINE / sizeof *SINE)
#define SIGN_BIT (8 * (int)sizeof(real) - 1)

INLINE void sine_cosine(vec x, vec *s, vec *c) {
  vec big = x * (real)(2 / PI) + MAGIC, n = big - MAGIC, r = x;
  for (int i = 0; i < 3; i++) r -= n * QUARTER_TURN[i];
  vec z = r * r, sine = all(SINE[0]), cosine = all(COSINE[0]);
  for (size_t i = 1; i < TERMS; i++) sine = sine * z + SINE[i], cosine = cosine * z + COSINE[i];
  sine = sine * z * r + r;
  cosine = cosine * z * z - z / 2 + 1;
  vwhole turns = (vwhole)big, odd = (turns & 1) != 0;
  *s = (vec)((vwhole)select_vec(odd, cosine, sine) ^ (turns >> 1 << SIGN_BIT));
  *c = (vec)((vwhole)select_vec(odd, sine, cosine) ^ ((turns + 1) >> 1 << SIGN_BIT));
  vwhole far = ~(vec_abs(x) <= MOST_TURNED);
  if (__builtin_expect(bits_of(far) != 0, 0))
    for (int i = 0; i < WIDTH; i++)
      if (far[i]) (*s)[i] = FN(sin)(x[i]), (*c)[i] = FN(cos)(x[i]);
}
INLINE vec wrap(vec angle) {
  return angle - (real)(2 * PI) * vec_floor((angle + (real)PI) / (real)(2 * PI));
}
/* Cosine and sine of half the angle of (x, y), in [-pi/2, pi/2]. */
INLINE void half_angle(vec x, vec y, vec *c, vec *s) {
  vec size = vec_sqrt(x * x + y * y), share = select_vec(size == 0, all(1), x / size);
  vec larger = vec_sqrt((1 + vec_abs(share)) / 2);
  vec smaller = select_vec(size == 0, all(0), vec_abs(y) / (2 * size * larger));
  *c = select_vec(share >= 0, larger, smaller);
  *s = with_sign_of(select_vec(share >= 0, smaller, larger), y);
}
