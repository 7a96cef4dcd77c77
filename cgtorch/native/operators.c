/* Crossover and mutation of nodes and edges of a whole population, one pair after the other. */
#include "crossover.h"
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
int most_nodes(const int64_t *action, int64_t nodes, const int64_t *rows, int64_t count,
               int64_t *most) {
  *most = 0;
  for (int64_t i = 0; i < count; i++) {
    int64_t here = count_nodes(action + rows[i] * nodes, nodes);
    if (here > *most) *most = here;
  }
  return 0;
}

/* Individuals mutated. */
int mutated(const Graphs *from, const Graphs *to, const int64_t *shape, const float *strategy,
            int64_t key, int64_t width, const uint8_t *has_edge, int64_t actions, int64_t rows,
            int64_t threads) {
  Shape of = {shape[0], shape[1]};
  Operators all = {.from = *from, .to = *to, .shape = of};
  all.mutation = (Mutation){of, strategy, key, width, has_edge, actions};
  in_parallel(some_individuals, &all, rows, 64, threads);
  return 0;
}

/* Copies of the elite, then children of pairs; they are mutated, too, if `has_edge` says what nodes
   can be. All have so many slots. */
int bred(const Graphs *from, const int64_t *elite, int64_t copies, const int64_t *parents,
         const Graphs *to, const int64_t *shape, const float *strategy, int64_t pair_key,
         int64_t pair_width, int64_t key, int64_t slots, const uint8_t *has_edge, int64_t actions,
         int64_t pairs, int64_t threads) {
  Shape before = {shape[0], shape[1]}, after = {slots, shape[1]};
  Operators all = {.to = *to, .shape = after, .first = copies};
  for (int64_t row = 0; row < copies; row++) {
    Graph graph;
    read_graph(&graph, from, before, elite[row]);
    write_reached(&graph, to, after, row);
  }
  all.crossover = (Crossover){*from, before, parents, strategy, pair_key, pair_width, pairs};
  all.mutation = (Mutation){after, strategy, key, slots, has_edge, actions};
  in_parallel(some_pairs, &all, pairs, 32, threads);
  return 0;
}
