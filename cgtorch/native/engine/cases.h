/* Scores as epsilon-lexicase selection looks at them. */
#pragma once
#include "draws.h"
#include "order.h"

static inline int alike(const real *a, const real *b, int64_t count) {
  int64_t i = 0;
  while (i < count && a[i] == b[i]) i++;
  return i == count;
}

/* The same for equal scores. Multilinear: no step waits for the one before; there is one zero only. */
static inline uint64_t hash_of(const real *scores, int64_t count) {
  uint64_t hash = 0;
  for (int64_t j = 0; j < count; j++)
    hash += pattern_of(scores[j] + 0) * (GOLDEN * (uint64_t)(2 * j + 1));
  return mixed(hash);
}

/* The scenario that comes as number `place`, when those before it have been moved to the front:
   Fisher and Yates' shuffle as far as it is looked at. */
static inline int64_t next_case(int32_t *case_order, int64_t scenarios, int64_t place, uint64_t key) {
  int64_t at = place + pick(uniform(key, place), (int)(scenarios - place));
  int32_t found = case_order[at];
  case_order[at] = case_order[place];
  case_order[place] = found;
  return found;
}

/* A number in [0, 1) with all the digits of a double. */
static inline double fine(uint64_t key, int64_t i) { return (double)(word(key, i) >> 11) * 0x1p-53; }
