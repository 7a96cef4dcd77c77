/* Crossover and mutation of nodes and edges of a whole population, one pair after the other. */
#include "crossover.h"
#include "mutation.h"
#include "parallel.h"

typedef struct {
  Crossover crossover;
  Mutation mutation;
  Graphs from, to;
} Operators;

static void some_pairs(void *what, int64_t begin, int64_t end) {
  const Operators *all = what;
  const Crossover *c = &all->crossover;
  Graph child[2];
  for (int64_t pair = begin; pair < end; pair++) {
    cross(c, pair, &child[0], &child[1]);
    for (int i = 0; i < 2; i++) {
      int64_t row = i * c->pairs + pair;
      if (all->mutation.draws) mutate(&all->mutation, &child[i], row);
      write_reached(&child[i], &all->to, c->shape, row);
    }
  }
}

static void some_individuals(void *what, int64_t begin, int64_t end) {
  const Operators *all = what;
  Graph graph;
  for (int64_t row = begin; row < end; row++) {
    read_graph(&graph, &all->from, all->mutation.shape, row);
    mutate(&all->mutation, &graph, row);
    write_reached(&graph, &all->to, all->mutation.shape, row);
  }
}

static Mutation mutation_of(const int64_t *shape, const float *strategy, const int64_t *draws,
                            int64_t width, const uint8_t *has_edge, int64_t actions) {
  Shape of = {shape[0], shape[1]};
  int64_t words = words_for(8 + of.outcomes + width * (2 + of.outcomes));
  return (Mutation){of, strategy, draws, words, width, has_edge, actions};
}

static int64_t count_nodes(const int64_t *action, int64_t nodes) {
  int64_t count = 0;
  for (int64_t i = 0; i < nodes; i++) count += action[i] != NO_NODE;
  return count;
}

/* Which pairs are crossed, by draws (Q, 2): `chosen` numbers them, the others have -1; `totals` are
   how many they are, and the nodes of the largest parent. */
int paired(const int64_t *action, int64_t nodes, const int64_t *parents, int64_t pairs,
           const float *strategy, int64_t columns, const float *draws, int64_t *chosen,
           int64_t *sizes, int64_t *totals) {
  totals[0] = totals[1] = 0;
  for (int64_t i = 0; i < pairs; i++) {
    int64_t first = count_nodes(action + parents[i] * nodes, nodes);
    int64_t second = count_nodes(action + parents[pairs + i] * nodes, nodes);
    int64_t least = first < second ? first : second, most = first < second ? second : first;
    float both = strategy[i * columns] + strategy[(pairs + i) * columns];
    chosen[i] = draws[2 * i] < both / 2 && least >= 2 ? totals[0]++ : -1;
    sizes[i] = 1 + pick(draws[2 * i + 1], (int)(least / 2));
    if (most > totals[1]) totals[1] = most;
  }
  return 0;
}

/* Individuals mutated. */
int mutated(const Graphs *from, const Graphs *to, const int64_t *shape, const float *strategy,
            const int64_t *draws, int64_t width, const uint8_t *has_edge, int64_t actions,
            int64_t rows, int64_t threads) {
  Operators all = {.from = *from, .to = *to};
  all.mutation = mutation_of(shape, strategy, draws, width, has_edge, actions);
  in_parallel(some_individuals, &all, rows, 64, (int)threads);
  return 0;
}

/* Children of pairs; they are mutated, too, if there are draws for it. */
int bred(const Graphs *from, const int64_t *parents, const Graphs *to, const int64_t *shape,
         const int64_t *chosen, const int64_t *sizes, const int64_t *pair_draws, int64_t pair_width,
         const float *strategy, const int64_t *draws, int64_t width, const uint8_t *has_edge,
         int64_t actions, int64_t pairs, int64_t threads) {
  Shape of = {shape[0], shape[1]};
  int64_t words = words_for(2 + 2 * pair_width * (1 + of.outcomes));
  Operators all = {.to = *to};
  all.crossover = (Crossover){*from, of, parents, chosen, sizes, pair_draws, pair_width, words, pairs};
  all.mutation = mutation_of(shape, strategy, draws, width, has_edge, actions);
  in_parallel(some_pairs, &all, pairs, 32, (int)threads);
  return 0;
}
