/* Scores, as epsilon-lexicase selection and ranking compare them (cgtorch.evolution.selection). */
#pragma once
#include "draws.h"
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

static inline int alike(const real *a, const real *b, int64_t count) {
  int64_t i = 0;
  while (i < count && a[i] == b[i]) i++;
  return i == count;
}

/* A hash of scores. It is multilinear, so that no step waits for the one before; both zeros count as one. */
static inline uint64_t hash_of(const real *scores, int64_t count) {
  uint64_t hash = 0;
  for (int64_t j = 0; j < count; j++)
    hash += pattern_of(scores[j] + 0) * (GOLDEN * (uint64_t)(2 * j + 1));
  return mixed(hash);
}

/* The scenario number `place` of a random order; those before it have been moved to the front. It is Fisher
   and Yates' shuffle, carried out as far as needed. */
static inline int64_t next_case(int32_t *case_order, int64_t scenarios, int64_t place, uint64_t key) {
  int64_t at = place + pick(uniform(key, place), (int)(scenarios - place));
  int32_t found = case_order[at];
  case_order[at] = case_order[place];
  case_order[place] = found;
  return found;
}

/* A number in [0, 1) with the full precision of a double. */
static inline double fine(uint64_t key, int64_t i) { return (double)(word(key, i) >> 11) * 0x1p-53; }

#define CANDIDATES 1024 /* individuals of a group at most, on a GPU */

/* Groups of `members`, of which the first `larger` have one more than `smaller`; each group gives as many
   parents as it has members on average. */
typedef struct {
  const real *scores;     /* (P, B) in the order of members */
  const real *epsilon;    /* (G, B) */
  const int64_t *members; /* (P,) individuals, group after group */
  const int64_t *keys;    /* (G,) */
  real *cases;            /* (G, B, CANDIDATES) scores of those in order */
  int32_t *ordered;       /* (G, CANDIDATES) members of a group, those of equal scores side by side */
  int32_t *leader;        /* (G, CANDIDATES) of these the first with their scores */
  int32_t *case_order;    /* (warps, B) */
  int64_t *chosen;        /* (count,) */
  int64_t scenarios, groups, smaller, larger, count, warps;
} Groups;
