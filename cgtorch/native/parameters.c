/* Parameters of children (cgtorch.evolution.parameters): copied from where the marks of nodes say,
   with Gaussian steps where they are hit. */
#include "draws.h"
#include "parallel.h"
#include <string.h>

typedef REAL real;

typedef struct {
  const int64_t *action, *num_parameters; /* (P, N), and of each of so many actions */
  int64_t actions, nodes;
} Nodes;

static inline int64_t parameters_at(const Nodes *of, int64_t slot) {
  int64_t action = of->action[slot];
  return action < 0 || action >= of->actions ? 0 : of->num_parameters[action];
}

/* Marks nodes that have no mark with -1, -2, ..., and returns in `new` (P N + 1,) how many there are
   and then which. */
int fresh_nodes(const int64_t *action, int64_t *marks, int64_t total, int64_t *new) {
  int64_t count = 0;
  for (int64_t i = 0; i < total; i++)
    if (action[i] >= 0 && !marks[i]) {
      new[++count] = i;
      marks[i] = -count;
    }
  new[0] = count;
  return 0;
}

/* How many parameters each individual has, and where its words begin among those of all; the last
   of `first` (P + 1,) is how many words there are. */
int parameter_counts(const int64_t *action, const int64_t *num_parameters, int64_t actions,
                     int64_t nodes, int64_t *counts, int64_t *first, int64_t rows) {
  Nodes of = {action, num_parameters, actions, nodes};
  first[0] = 0;
  for (int64_t row = 0; row < rows; row++) {
    int64_t count = 0;
    for (int64_t i = 0; i < nodes; i++) count += parameters_at(&of, row * nodes + i);
    counts[row] = count;
    first[row + 1] = first[row] + words_for(count);
  }
  return 0;
}

typedef struct {
  const int64_t *counts, *first, *draws; /* (P,), (P + 1,), and words of random bits */
  const float *rate;                     /* (P,) */
  int64_t *hits;                         /* (P + 1,) where those of each individual begin */
} Hits;

static void some_hits(void *what, int64_t begin, int64_t end) {
  const Hits *h = what;
  for (int64_t row = begin; row < end; row++) {
    const int64_t *words = h->draws + h->first[row];
    int64_t limit = below(h->rate[row]), hits = 0;
    int64_t full = h->counts[row] / IN_A_WORD, i = full * IN_A_WORD;
    for (int64_t w = 0; w < full; w++)
      for (int j = 0; j < IN_A_WORD; j++) hits += (words[w] >> j * BITS & FIELD) < limit;
    for (; i < h->counts[row]; i++) hits += field(words, i) < limit;
    h->hits[row] = hits;
  }
}

int parameter_hits(const int64_t *counts, const int64_t *first, const int64_t *draws,
                   const float *rate, int64_t *hits, int64_t rows, int64_t threads) {
  Hits h = {counts, first, draws, rate, hits};
  in_parallel(some_hits, &h, rows, 256, (int)threads);
  int64_t total = 0;
  for (int64_t row = 0; row <= rows; row++) {
    int64_t mine = row < rows ? hits[row] : 0;
    hits[row] = total;
    total += mine;
  }
  return 0;
}

typedef struct {
  Hits hits;
  Nodes of;
  const int64_t *marks;       /* (P, N) r + 1 for row r of `old`, -r - 1 of `fresh`, 0 for none */
  const real *old, *fresh;
  real *parameters;           /* (P, N, K) */
  int64_t most;               /* K */
  const float *sigma;         /* (P,) */
  const float *normal;        /* one for each hit */
} Children;

static void some_children(void *what, int64_t begin, int64_t end) {
  const Children *c = what;
  int64_t n = c->of.nodes, k = c->most;
  for (int64_t row = begin; row < end; row++) {
    const int64_t *words = c->hits.draws + c->hits.first[row];
    int64_t limit = below(c->hits.rate[row]), at = 0;
    const float *normal = c->normal + c->hits.hits[row];
    memset(c->parameters + row * n * k, 0, (size_t)(n * k) * sizeof(real));
    for (int64_t i = row * n; i < (row + 1) * n; i++) {
      real *parameters = c->parameters + i * k;
      int64_t mark = c->marks[i], count = parameters_at(&c->of, i);
      if (!mark || !count) continue;
      memcpy(parameters, mark > 0 ? c->old + (mark - 1) * k : c->fresh + (-mark - 1) * k,
             (size_t)count * sizeof(real));
      for (int64_t j = 0; j < count; j++)
        if (field(words, at + j) < limit) {
          float step = *normal++ * c->sigma[row]; /* rounded before it is added, as in torch */
          parameters[j] += step;
        }
      at += count;
    }
  }
}

int parameters_of(const int64_t *counts, const int64_t *first, const int64_t *draws,
                  const float *rate, int64_t *hits, const float *sigma, const float *normal,
                  const int64_t *action, const int64_t *num_parameters, int64_t actions,
                  int64_t nodes, const int64_t *marks, const real *old, const real *fresh,
                  int64_t most, real *parameters, int64_t rows, int64_t threads) {
  Nodes of = {action, num_parameters, actions, nodes};
  Children c = {{counts, first, draws, rate, hits}, of, marks, old, fresh, parameters, most,
                sigma, normal};
  in_parallel(some_children, &c, rows, 64, (int)threads);
  return 0;
}
