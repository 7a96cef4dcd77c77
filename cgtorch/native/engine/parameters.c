/* Parameters of children (cgtorch.evolution.parameters): copied from where the origins of nodes
   say, with Gaussian steps where they are hit; and the drift of their strategies (eq. 2). */
#define _DEFAULT_SOURCE /* of madvise */
#include "draws.h"
#include "library.h"
#include <string.h>
#include <sys/mman.h>

#define PIECE 16 /* words that are made at once */

typedef REAL real;

/* `same` individuals come first, of whom all stays as it is. */
typedef struct {
  const int64_t *action, *num_parameters; /* (P, N), and of each of so many actions */
  const int64_t *origins; /* (P, N) r + 1 for row r of `old`, -r - 1 of `fresh`, 0 for none */
  const real *old, *fresh;
  const float *strategy; /* (P, STRATEGY) of parents */
  const float *factors;  /* (P - same, STRATEGY) that eq. 2 multiplies it by */
  const float *bounds;   /* (2, STRATEGY) the least and the most */
  const float *quantiles; /* (1281, 3), cgtorch.ground.counter_rng.quantiles */
  real *parameters;       /* (P, N, K) */
  float *drifted;         /* (P, STRATEGY) */
  int64_t rows, nodes, most, actions, same, key; /* P, N, K, A */
} Children;
EXPORT_STRUCT(Children)

static inline int64_t parameters_at(const Children *c, int64_t slot) {
  int64_t action = c->action[slot];
  return action < 0 || action >= c->actions ? 0 : c->num_parameters[action];
}

/* Strategies as they were, or drifted (cgtorch.evolution.population.drifted). */
static inline void drift(const Children *c, int64_t row) {
  const float *from = c->strategy + row * STRATEGY, *least = c->bounds, *most = least + STRATEGY;
  float *to = c->drifted + row * STRATEGY;
  if (row < c->same) {
    memcpy(to, from, STRATEGY * sizeof *to);
    return;
  }
  const float *by = c->factors + (row - c->same) * STRATEGY;
  for (int i = 0; i < STRATEGY; i++) {
    float x = from[i] * by[i];
    to[i] = x < least[i] ? least[i] : x > most[i] ? most[i] : x;
  }
}

/* A standard normal number (cgtorch.ground.counter_rng.normal_from). */
static inline float normal(const float *quantiles, uint64_t word) {
  float chance = (float)(int64_t)((word & (((uint64_t)1 << 39) - 1)) * 2 + 1);
  int32_t bits;
  memcpy(&bits, &chance, sizeof bits);
  const float *at = quantiles + 3 * ((bits >> 18) - 127 * 32);
  float place = (float)(bits & ((1 << 18) - 1)) * 0x1p-18f;
  float size = at[0] + place * (at[1] + place * at[2]);
  return word >> 39 & 1 ? -size : size;
}

/* Steps of the `count` parameters of a node, whose words are those from number `first` on. */
static inline void some_steps(const Children *c, uint64_t key, uint64_t limit, float sigma,
                              int64_t first, int64_t count, real *parameters) {
  uint64_t words[PIECE];
  int which[PIECE];
  for (int64_t begin = 0; begin < count; begin += PIECE) {
    int here = (int)(count - begin < PIECE ? count - begin : PIECE), hits = 0;
    for (int i = 0; i < PIECE; i++) words[i] = word(key, first + begin + i);
    /* Without branches, as no CPU foresees them: each is written down, and stays if it is hit. */
    for (int i = 0; i < here; i++) {
      which[hits] = i;
      hits += words[i] >> (64 - BITS) < limit;
    }
    for (int i = 0; i < hits; i++)
      parameters[begin + which[i]] += normal(c->quantiles, words[which[i]]) * sigma;
  }
}

static void some_children(void *what, int64_t begin, int64_t end) {
  const Children *c = what;
  int64_t n = c->nodes, k = c->most;
  for (int64_t row = begin; row < end; row++) {
    const float *strategy = c->strategy + row * STRATEGY;
    uint64_t key = key_of(c->key, row), limit = row < c->same ? 0 : below(strategy[MUTATE_PARAMETER]);
    for (int64_t i = row * n, first = 0; i < (row + 1) * n; i++) {
      int64_t origin = c->origins[i], count = origin ? parameters_at(c, i) : 0;
      real *parameters = c->parameters + i * k;
      const real *from = origin > 0 ? c->old + (origin - 1) * k : c->fresh + (-origin - 1) * k;
      if (count) memcpy(parameters, from, (size_t)count * sizeof(real));
      memset(parameters + count, 0, (size_t)(k - count) * sizeof(real));
      some_steps(c, key, limit, strategy[SIGMA], first, count, parameters);
      first += count;
    }
    drift(c, row);
  }
}

int changed(const Children *c, int64_t threads) {
  large_pages(c->parameters, (size_t)(c->rows * c->nodes * c->most) * sizeof(real));
  in_parallel(some_children, (void *)c, c->rows, 64, threads);
  return 0;
}
