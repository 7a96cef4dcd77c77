/* Crossover and mutation of nodes and edges of a whole population, one pair after the other. */
#include "crossover.h"
#include "exported.h"
#include "mutation.h"
#include "parallel.h"
#include "parameter_origin.h"

EXPORT_CONSTANTS(graph_limits, MOST_NODES, MOST_OUTCOMES)
EXPORT_CONSTANTS(strategy, CROSSOVER, ADD_NODE, DELETE_NODE, NEW_START, REPLACE_NODE, CHANGE_EDGE,
                 MUTATE_PARAMETER, SIGMA)

/* What children are made of, and room for what they are. */
typedef struct {
  Graphs given, made;
  const int64_t *elite;    /* (E,) of `given` */
  const int64_t *parents;  /* (2 Q,) of `given`, the first ones and then the second ones */
  const float *strategy;   /* (P, STRATEGY) of `given` */
  float *parent_strategy;  /* (E + 2 Q, STRATEGY) of the elite and of parents */
  const uint8_t *has_edge; /* (A, O), or NULL where nothing is mutated */
  int64_t *first;          /* (A + 1,) for `number_new_nodes`, unless nothing is mutated */
  int64_t individuals, nodes, outcomes, elites, pairs, actions, pair_key, key;
  int64_t slots; /* that graphs may have in the end; set to as many as the largest may need */
} Breeding;
EXPORT_STRUCT(Graphs)
EXPORT_STRUCT(Breeding)

typedef struct {
  Crossover crossover;
  Mutation mutation;
  Graphs to;
  int64_t first; /* row of `to` that children begin at */
} Operators;

static void some_pairs(void *what, int64_t begin, int64_t end) {
  const Operators *all = what;
  const Crossover *c = &all->crossover;
  Graph child[2];
  for (int64_t pair = begin; pair < end; pair++) {
    cross(c, pair, &child[0], &child[1]);
    for (int i = 0; i < 2; i++) {
      int64_t row = i * c->pairs + pair;
      if (all->mutation.has_edge) mutate(&all->mutation, &child[i], row);
      write_reached(&child[i], &all->to, all->mutation.shape, all->first + row);
    }
  }
}

/* Nodes of the largest of some graphs. */
static int64_t most_nodes(const Graphs *graphs, int64_t nodes, const int64_t *rows, int64_t count) {
  int64_t most = 0;
  for (int64_t i = 0; i < count; i++) {
    int64_t here = 0;
    for (int64_t j = 0; j < nodes; j++) here += graphs->action[rows[i] * nodes + j] != NO_NODE;
    if (here > most) most = here;
  }
  return most;
}

static void take_rows(const float *from, const int64_t *rows, int64_t count, float *to) {
  for (int64_t i = 0; i < count; i++)
    memcpy(to + i * STRATEGY, from + rows[i] * STRATEGY, STRATEGY * sizeof *to);
}

static int all_there(const int64_t *rows, int64_t count, int64_t individuals) {
  int there = 1;
  for (int64_t i = 0; i < count; i++) there &= rows[i] >= 0 && rows[i] < individuals;
  return there;
}

/* Copies of the elite, then children of pairs; where they are mutated, they may have a node more, and
   their new nodes are numbered. NO_PARENT where one of the elite or of the parents is none of the
   individuals. */
int bred(Breeding *b, int64_t threads) {
  int64_t children = 2 * b->pairs;
  if (!all_there(b->elite, b->elites, b->individuals)) return NO_PARENT;
  if (!all_there(b->parents, children, b->individuals)) return NO_PARENT;
  int64_t width = most_nodes(&b->given, b->nodes, b->elite, b->elites);
  int64_t other = most_nodes(&b->given, b->nodes, b->parents, children);
  if (width < other) width = other;
  if (b->has_edge && b->slots > width + 1) b->slots = width + 1;
  Shape before = {b->nodes, b->outcomes}, after = {b->slots, b->outcomes};
  float *strategy = b->parent_strategy + b->elites * STRATEGY;
  take_rows(b->strategy, b->elite, b->elites, b->parent_strategy);
  take_rows(b->strategy, b->parents, children, strategy);
  for (int64_t row = 0; row < b->elites; row++) {
    Graph graph;
    read_graph(&graph, &b->given, before, b->elite[row]);
    write_reached(&graph, &b->made, after, row);
  }
  Operators all = {
      .crossover = {b->given, before, b->parents, strategy, b->pair_key, width, b->pairs},
      .mutation = {after, strategy, b->key, b->slots, b->has_edge, b->actions},
      .to = b->made, .first = b->elites};
  in_parallel(some_pairs, &all, b->pairs, 32, threads);
  if (!b->has_edge) return DONE;
  int64_t slots = (b->elites + children) * b->slots, *origins = b->made.origins;
  return number_new_nodes(b->made.action, origins, slots, b->actions, b->first) ? DONE : NO_MEMORY;
}
