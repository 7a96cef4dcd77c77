/* Crossover and mutation of nodes and edges of a whole population, one pair after the other. */
#include "crossover.h"
#include "marks.h"
#include "mutation.h"
#include "parallel.h"

typedef struct {
  Crossover crossover;
  Mutation mutation;
  Graphs from, to;
  Shape shape;   /* of `to` */
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
      write_reached(&child[i], &all->to, all->shape, all->first + row);
    }
  }
}

static void some_individuals(void *what, int64_t begin, int64_t end) {
  const Operators *all = what;
  Graph graph;
  for (int64_t row = begin; row < end; row++) {
    read_graph(&graph, &all->from, all->mutation.shape, row);
    mutate(&all->mutation, &graph, row);
    write_reached(&graph, &all->to, all->shape, row);
  }
}

static int64_t count_nodes(const int64_t *action, int64_t nodes) {
  int64_t count = 0;
  for (int64_t i = 0; i < nodes; i++) count += action[i] != NO_NODE;
  return count;
}

/* Nodes of the largest of some graphs. */
static int64_t most_nodes(const Graphs *graphs, int64_t nodes, const int64_t *rows, int64_t count) {
  int64_t most = 0;
  for (int64_t i = 0; i < count; i++) {
    int64_t here = count_nodes(graphs->action + rows[i] * nodes, nodes);
    if (here > most) most = here;
  }
  return most;
}

/* Individuals mutated, their new nodes marked; `first` (A + 1,) is for `mark_new`. 1 for want of
   memory. */
int mutated(const Graphs *from, const Graphs *to, const int64_t *shape, const float *strategy,
            int64_t key, int64_t width, const uint8_t *has_edge, int64_t actions, int64_t *first,
            int64_t rows, int64_t threads) {
  Shape of = {shape[0], shape[1]};
  Operators all = {.from = *from, .to = *to, .shape = of};
  all.mutation = (Mutation){of, strategy, key, width, has_edge, actions};
  in_parallel(some_individuals, &all, rows, 64, threads);
  return mark_new(to->action, to->marks, rows * of.nodes, actions, first);
}

/* What children are made of, and room for what they are. */
typedef struct {
  Graphs from, to;
  const int64_t *elite;    /* (E,) of `from` */
  const int64_t *parents;  /* (2 Q,) of `from`, the first ones and then the second ones */
  const float *strategy;   /* (P, STRATEGY) of `from` */
  float *theirs;           /* (E + 2 Q, STRATEGY) of the elite and of parents */
  const uint8_t *has_edge; /* (A, O), or NULL where nothing is mutated */
  int64_t *first;          /* (A + 1,) for `mark_new`, unless nothing is mutated */
  int64_t people, nodes, outcomes, elites, pairs, actions, pair_key, key;
  int64_t slots; /* that graphs may have in the end; set to as many as the largest may need */
} Breeding;

static void take_rows(const float *from, const int64_t *rows, int64_t count, float *to) {
  for (int64_t i = 0; i < count; i++)
    memcpy(to + i * STRATEGY, from + rows[i] * STRATEGY, STRATEGY * sizeof *to);
}

static int all_there(const int64_t *rows, int64_t count, int64_t people) {
  int there = 1;
  for (int64_t i = 0; i < count; i++) there &= rows[i] >= 0 && rows[i] < people;
  return there;
}

/* Copies of the elite, then children of pairs; where they are mutated, they may have a node more, and
   their new nodes are marked. 1 for want of memory, 2 where a parent is none of the individuals. */
int bred(Breeding *b, int64_t threads) {
  int64_t children = 2 * b->pairs;
  if (!all_there(b->elite, b->elites, b->people) || !all_there(b->parents, children, b->people))
    return 2;
  int64_t width = most_nodes(&b->from, b->nodes, b->elite, b->elites);
  int64_t other = most_nodes(&b->from, b->nodes, b->parents, children);
  if (width < other) width = other;
  if (b->has_edge && b->slots > width + 1) b->slots = width + 1;
  Shape before = {b->nodes, b->outcomes}, after = {b->slots, b->outcomes};
  Operators all = {.to = b->to, .shape = after, .first = b->elites};
  float *theirs = b->theirs + b->elites * STRATEGY;
  take_rows(b->strategy, b->elite, b->elites, b->theirs);
  take_rows(b->strategy, b->parents, children, theirs);
  for (int64_t row = 0; row < b->elites; row++) {
    Graph graph;
    read_graph(&graph, &b->from, before, b->elite[row]);
    write_reached(&graph, &b->to, after, row);
  }
  all.crossover = (Crossover){b->from, before, b->parents, theirs, b->pair_key, width, b->pairs};
  all.mutation = (Mutation){after, theirs, b->key, b->slots, b->has_edge, b->actions};
  in_parallel(some_pairs, &all, b->pairs, 32, threads);
  if (!b->has_edge) return 0;
  int64_t slots = (b->elites + children) * b->slots;
  return mark_new(b->to.action, b->to.marks, slots, b->actions, b->first);
}
