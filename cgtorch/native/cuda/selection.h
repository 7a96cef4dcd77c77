/* What epsilon-lexicase selection on a GPU is told (cgtorch.evolution.gpu). */
#pragma once
#ifndef __CUDACC_RTC__
#include <stdint.h>
#endif

#define CANDIDATES 1024 /* individuals of a group at most */

/* Groups of `members`, of which the first `larger` have one more than `smaller`; so many parents each. */
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
