/* Graphs laid out for rollouts: kinds and heads of every node (cgtorch.simulation.program). */
#include "parallel.h"

#define NO_NODE (-1)
#define FAILURE (-2)
#define PIECE 256

typedef struct {
  const int64_t *action, *edges; /* (P, N), (P, N, seen) */
  const int64_t *kinds, *ends;   /* (A,), (A, seen): of each action, and where its outcomes end */
  int64_t graphs, nodes, seen, outcomes, offset;
  int64_t *kind, *heads; /* (P * N,), (P * N, outcomes) */
} Tables;

static void some_graphs(void *what, int64_t begin, int64_t end) {
  const Tables *t = what;
  for (int64_t graph = begin; graph < end; graph++) {
    int64_t first = t->offset + graph * t->nodes;
    for (int64_t row = graph * t->nodes; row < (graph + 1) * t->nodes; row++) {
      int64_t action = t->action[row] < 0 ? 0 : t->action[row], *heads = t->heads + row * t->outcomes;
      const int64_t *edges = t->edges + row * t->seen, *ends = t->ends + action * t->seen;
      t->kind[row] = t->kinds[action];
      for (int64_t o = 0; o < t->outcomes; o++)
        heads[o] = o >= t->seen ? FAILURE : edges[o] == NO_NODE ? ends[o] : first + edges[o];
    }
  }
}

int lay_out(Tables *tables, int64_t threads) {
  in_parallel(some_graphs, tables, tables->graphs, PIECE, (int)threads);
  return 0;
}
