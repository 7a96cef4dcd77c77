/* Crossover, mutation and parameters of a whole population. */
#define _DEFAULT_SOURCE /* of madvise */
#include "library.h"
#include "operators.h"
#include <sys/mman.h>

EXPORT_CONSTANTS(graph_limits, MOST_NODES, MOST_OUTCOMES)
EXPORT_CONSTANTS(strategy, CROSSOVER, ADD_NODE, DELETE_NODE, NEW_START, REPLACE_NODE, CHANGE_EDGE,
                 MUTATE_PARAMETER, SIGMA)
EXPORT_STRUCT(Graphs)
EXPORT_STRUCT(Breeding)
EXPORT_STRUCT(Children)

/* The number of nodes of the largest of some graphs, or -1 if a row is not among the individuals. */
int widest(const int64_t *action, int64_t nodes, int64_t individuals, const int64_t *rows, int64_t count) {
  int most = 0;
  for (int64_t i = 0; i < count; i++) {
    int here = 0;
    if (rows[i] < 0 || rows[i] >= individuals) return -1;
    for (int64_t j = 0; j < nodes; j++) here += action[rows[i] * nodes + j] != NO_NODE;
    most = here > most ? here : most;
  }
  return most;
}

static void some_pairs(void *what, int64_t begin, int64_t end) {
  for (int64_t pair = begin; pair < end; pair++) make_pair(what, pair);
}

/* Copies the elite, then makes children of pairs. */
int breed(const Breeding *b, int64_t threads) {
  for (int64_t row = 0; row < b->elites; row++) copy_elite(b, row);
  in_parallel(some_pairs, (void *)b, b->pairs, 32, threads);
  return DONE;
}

#define PIECE 16 /* words that are made at once */

/* Perturbs the `count` parameters of a node, whose words begin at number `first`. */
static inline void some_steps(const Children *c, uint64_t key, uint64_t limit, float sigma,
                              int64_t first, int64_t count, real *parameters) {
  uint64_t words[PIECE];
  int which[PIECE];
  for (int64_t begin = 0; begin < count; begin += PIECE) {
    int here = (int)(count - begin < PIECE ? count - begin : PIECE), hits = 0;
    for (int i = 0; i < PIECE; i++) words[i] = word(key, first + begin + i);
    /* Without branches, which CPUs could not predict: each value is written, and kept if it is hit. */
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
      int64_t count = parameters_at(c, i);
      real *parameters = c->parameters + i * k;
      const real *from = origin_of(c, i);
      if (from) memcpy(parameters, from, (size_t)count * sizeof(real));
      else
        for (int64_t j = 0; j < count; j++) parameters[j] = fresh_number(c, key, row, i, j);
      memset(parameters + count, 0, (size_t)(k - count) * sizeof(real));
      some_steps(c, key, limit, strategy[SIGMA], first, count, parameters);
      first += count;
    }
    for (int j = 0; j < STRATEGY; j++) c->drifted[row * STRATEGY + j] = drifted(c, key, row, j);
  }
}

int perturb_parameters(const Children *c, int64_t threads) {
  large_pages(c->parameters, (size_t)(c->rows * c->nodes * c->most) * sizeof(real));
  in_parallel(some_children, (void *)c, c->rows, 64, threads);
  return 0;
}
