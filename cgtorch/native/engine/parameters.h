/* Parameters of children (cgtorch.evolution.parameters): copied from their origins or drawn, then perturbed
   by Gaussian steps; and the drift of strategies (eq. 2). */
#pragma once
#include "draws.h"
#include "real.h"

/* The first `same` individuals stay unchanged. */
typedef struct {
  const int64_t *action, *num_parameters; /* (P, N), and of each of so many actions */
  const int64_t *standard; /* (A,) whether parameters of new nodes are standard normal */
  const int64_t *origins; /* (P, N) r + 1 for row r of `old`, -r - 1 of `fresh`, 0 for those or none */
  const real *old, *fresh;
  const float *strategy; /* (P, STRATEGY) of parents */
  const float *bounds;   /* (2, STRATEGY) the least and the most */
  const float *quantiles; /* (1281, 3), cgtorch.ground.counter_rng.quantiles */
  real *parameters;       /* (P, N, K) */
  float *drifted;         /* (P, STRATEGY) */
  int64_t rows, nodes, most, actions, same, key; /* P, N, K, A */
  float spread; /* sqrt(tau) / log 2 */
} Children;

static inline int64_t parameters_at(const Children *c, int64_t slot) {
  int64_t action = c->action[slot];
  return action < 0 || action >= c->actions ? 0 : c->num_parameters[action];
}

/* The origin of a node's parameters; NULL if they are drawn. */
static inline const real *origin_of(const Children *c, int64_t slot) {
  int64_t origin = c->origins[slot];
  return !origin ? NULL : origin > 0 ? c->old + (origin - 1) * c->most : c->fresh + (-origin - 1) * c->most;
}
/* Number j of the parameters of a new node. */
static inline real fresh_number(const Children *c, uint64_t key, int64_t row, int64_t slot, int64_t j) {
  int64_t place = (slot - row * c->nodes) * c->most + j;
  return c->standard[c->action[slot]] ? normal(c->quantiles, word(key, FRESH + place)) : 0;
}

/* Strategies as they were, or with number i multiplied by exp(N(0, tau)), within its bounds (eq. 2). */
static inline float drifted(const Children *c, uint64_t key, int64_t row, int i) {
  float x = c->strategy[row * STRATEGY + i];
  if (row < c->same) return x;
  x *= power_of_two(normal(c->quantiles, word(key, DRIFT + i)) * c->spread);
  float least = c->bounds[i], most = c->bounds[STRATEGY + i];
  return x < least ? least : x > most ? most : x;
}
