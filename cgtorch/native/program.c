/* Graphs laid out for rollouts: kinds and heads of every node (cgtorch.simulation.program). */
#include "parallel.h"

#define NO_NODE (-1)
#define FAILURE (-2)
#define PIECE 256

typedef struct {
  const int64_t *action, *edges, *start; /* (P, N), (P, N, seen), (P,) */
  const int64_t *kinds, *ends; /* (A,), (A, seen): of each action, and where its outcomes end */
  int64_t graphs, nodes, seen, actions, outcomes, offset;
  int64_t *kind, *heads, *first; /* (P * N,), (P * N, outcomes), (P,) */
  int64_t wrong; /* set where a graph has numbers that are none of its nodes or actions */
} Tables;

static inline int outside(int64_t number, int64_t count) { return number < NO_NODE || number >= count; }

static void some_graphs(void *what, int64_t begin, int64_t end) {
  Tables *t = what;
  int wrong = 0;
  for (int64_t graph = begin; graph < end; graph++) {
    int64_t base = t->offset + graph * t->nodes;
    t->first[graph] = base + t->start[graph];
    wrong |= t->start[graph] < 0 || t->start[graph] >= t->nodes;
    for (int64_t row = graph * t->nodes; row < (graph + 1) * t->nodes; row++) {
      int64_t given = t->action[row], *heads = t->heads + row * t->outcomes;
      int64_t action = given < 0 || given >= t->actions ? 0 : given;
      const int64_t *edges = t->edges + row * t->seen, *ends = t->ends + action * t->seen;
      wrong |= outside(given, t->actions);
      t->kind[row] = t->kinds[action];
      for (int64_t o = 0; o < t->outcomes; o++)
        heads[o] = o >= t->seen ? FAILURE : edges[o] == NO_NODE ? ends[o] : base + edges[o];
      for (int64_t o = 0; o < t->seen; o++) wrong |= outside(edges[o], t->nodes);
    }
  }
  if (wrong) __atomic_store_n(&t->wrong, 1, __ATOMIC_RELAXED);
}

int lay_out(Tables *tables, int64_t threads) {
  in_parallel(some_graphs, tables, tables->graphs, PIECE, threads);
  return (int)tables->wrong;
}
