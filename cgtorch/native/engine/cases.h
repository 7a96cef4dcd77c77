/* Scores for epsilon-lexicase selection. */
#pragma once
#include "draws.h"
#include "order.h"

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
