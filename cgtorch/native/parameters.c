/* Gaussian steps of the parameters that are hit (cgtorch.evolution.parameters). */
#include "graph.h"
#include "parallel.h"

typedef struct {
  const int64_t *action, *num_parameters; /* (P, N), and of each of so many actions */
  int64_t actions, nodes;
} Nodes;

static inline int64_t parameters_at(const Nodes *of, int64_t slot) {
  int64_t action = of->action[slot];
  return action < 0 || action >= of->actions ? 0 : of->num_parameters[action];
}

/* How many parameters each individual has. */
int parameter_counts(const int64_t *action, const int64_t *num_parameters, int64_t actions,
                     int64_t nodes, int64_t *counts, int64_t rows) {
  Nodes of = {action, num_parameters, actions, nodes};
  for (int64_t row = 0; row < rows; row++) {
    counts[row] = 0;
    for (int64_t i = 0; i < nodes; i++) counts[row] += parameters_at(&of, row * nodes + i);
  }
  return 0;
}

typedef struct {
  const int64_t *first; /* (P + 1,) where an individual's parameters begin in `draws` */
  const float *draws;   /* one for each parameter */
  const float *rate;    /* (P,) */
  int64_t *hits;        /* (P,) how many parameters are hit */
} Hits;

static void some_hits(void *what, int64_t begin, int64_t end) {
  const Hits *h = what;
  for (int64_t row = begin; row < end; row++) {
    int32_t count = 0;
    for (int64_t i = h->first[row]; i < h->first[row + 1]; i++) count += h->draws[i] < h->rate[row];
    h->hits[row] = count;
  }
}

int parameter_hits(const int64_t *first, const float *draws, const float *rate, int64_t *hits,
                   int64_t rows, int64_t threads) {
  Hits h = {first, draws, rate, hits};
  in_parallel(some_hits, &h, rows, 256, (int)threads);
  return 0;
}

typedef struct {
  Hits hits;
  Nodes of;
  real *parameters;
  int64_t most;             /* K */
  const float *sigma;       /* (P,) */
  const float *normal;      /* one for each hit */
  const int64_t *first_hit; /* (P,) where an individual's begin */
} Steps;

static void some_steps(void *what, int64_t begin, int64_t end) {
  const Steps *s = what;
  for (int64_t row = begin; row < end; row++) {
    const float *draw = s->hits.draws + s->hits.first[row], rate = s->hits.rate[row];
    const float *normal = s->normal + s->first_hit[row];
    for (int64_t i = row * s->of.nodes; i < (row + 1) * s->of.nodes; i++) {
      int64_t count = parameters_at(&s->of, i);
      real *parameters = s->parameters + i * s->most;
      for (int64_t j = 0; j < count; j++)
        if (draw[j] < rate) {
          float step = *normal++ * s->sigma[row]; /* rounded before it is added, as in torch */
          parameters[j] += step;
        }
      draw += count;
    }
  }
}

int parameter_steps(const int64_t *first, const float *draws, const float *rate,
                    const int64_t *action, real *parameters, const int64_t *num_parameters,
                    int64_t actions, int64_t nodes, int64_t most, const float *sigma,
                    const float *normal, const int64_t *first_hit, int64_t rows, int64_t threads) {
  Nodes of = {action, num_parameters, actions, nodes};
  Steps s = {{first, draws, rate, NULL}, of, parameters, most, sigma, normal, first_hit};
  in_parallel(some_steps, &s, rows, 64, (int)threads);
  return 0;
}
