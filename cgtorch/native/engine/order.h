/* The bits of numbers, and integers with the order of numbers. */
#pragma once
#include "real.h"

#ifdef REAL_IS_FLOAT
typedef uint32_t pattern;
#else
typedef uint64_t pattern;
#endif
#define SIGN ((pattern)1 << (sizeof(pattern) * 8 - 1))

INLINE pattern pattern_of(real x) {
  pattern p;
  memcpy(&p, &x, sizeof p);
  return p;
}
/* Less where the number is; of two zeros that with a sign comes first. */
INLINE pattern ordered(real x) {
  pattern p = pattern_of(x);
  return p & SIGN ? ~p : p | SIGN;
}
INLINE real number_of(pattern place) {
  real x;
  place = place & SIGN ? place & ~SIGN : ~place;
  memcpy(&x, &place, sizeof x);
  return x;
}
