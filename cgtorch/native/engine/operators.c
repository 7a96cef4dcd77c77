/* Crossover and mutation of nodes and edges of a whole population, one pair after the other. */
#include "crossover.h"
#include "library.h"
#include "mutation.h"
#include <stdlib.h>

EXPORT_CONSTANTS(graph_limits, MOST_NODES, MOST_OUTCOMES)
EXPORT_CONSTANTS(strategy, CROSSOVER, ADD_NODE, DELETE_NODE, NEW_START, REPLACE_NODE, CHANGE_EDGE,
                 MUTATE_PARAMETER, SIGMA)

EXPORT_STRUCT(Graphs)
EXPORT_STRUCT(Breeding)

static void some_pairs(void *what, int64_t begin, int64_t end) {
  const Breeding *b = what;
  Graph child[2];
  for (int64_t pair = begin; pair < end; pair++) {
    cross(b, pair, &child[0], &child[1]);
    for (int i = 0; i < 2; i++) {
      int64_t row = i * b->pairs + pair;
      if (b->has_edge) mutate(b, &child[i], row);
      write_reached(&child[i], &b->made, b->elites + row);
    }
  }
}

/* Nodes of the largest of some graphs. */
static int64_t most_nodes(const Graphs *graphs, const int64_t *rows, int64_t count) {
  int64_t most = 0;
  for (int64_t i = 0; i < count; i++) {
    const int64_t *action = graphs->action + rows[i] * graphs->nodes;
    int64_t here = 0;
    for (int64_t j = 0; j < graphs->nodes; j++) here += action[j] != NO_NODE;
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

/* Numbers new nodes whose parameters are not standard normal -1, -2, ..., first those of action 0, and so
   on, and writes the CSR offsets (A + 1,) by action to `first`; the last of them is how many there
   are. 0 for want of memory. */
static int number_new_nodes(const int64_t *action, int64_t *origins, int64_t total, int64_t actions,
                            const int64_t *standard, int64_t *first) {
  int64_t count = 0, *where = malloc((size_t)(total + 1) * sizeof *where);
  if (!where) return 0;
  memset(first, 0, (size_t)(actions + 1) * sizeof *first);
  for (int64_t i = 0; i < total; i++)
    if (!origins[i] && action[i] >= 0 && action[i] < actions && !standard[action[i]]) {
      where[count++] = i;
      origins[i] = -++first[action[i] + 1];
    }
  for (int64_t a = 0; a < actions; a++) first[a + 1] += first[a];
  for (int64_t i = 0; i < count; i++) origins[where[i]] -= first[action[where[i]]];
  free(where);
  return 1;
}

/* Copies of the elite, then children of pairs; where they are mutated, they may have a node more, and
   their new nodes are numbered. NO_PARENT where one of the elite or of the parents is none of the
   individuals. */
int breed(Breeding *b, int64_t threads) {
  int64_t children = 2 * b->pairs;
  if (!all_there(b->elite, b->elites, b->individuals)) return NO_PARENT;
  if (!all_there(b->parents, children, b->individuals)) return NO_PARENT;
  int64_t other = most_nodes(&b->given, b->parents, children);
  b->width = most_nodes(&b->given, b->elite, b->elites);
  if (b->width < other) b->width = other;
  if (b->has_edge && b->made.nodes > b->width + 1) b->made.nodes = b->width + 1;
  take_rows(b->strategy, b->elite, b->elites, b->parent_strategy);
  take_rows(b->strategy, b->parents, children, b->parent_strategy + b->elites * STRATEGY);
  for (int64_t row = 0; row < b->elites; row++) {
    Graph graph;
    read_graph(&graph, &b->given, b->elite[row]);
    write_reached(&graph, &b->made, row);
  }
  in_parallel(some_pairs, b, b->pairs, 32, threads);
  if (!b->has_edge) return DONE;
  int64_t slots = (b->elites + children) * b->made.nodes, *origins = b->made.origins;
  return number_new_nodes(b->made.action, origins, slots, b->actions, b->standard, b->first) ? DONE : NO_MEMORY;
}

typedef struct {
  int64_t *out, count;
  uint64_t key;
} Order;

static void some_places(void *what, int64_t begin, int64_t end) {
  const Order *o = what;
  for (int64_t i = begin; i < end; i++) o->out[i] = shuffled(i, o->count, o->key);
}

/* An order (count,) of as many that follows from a key. */
int shuffled_order(int64_t count, int64_t key, int64_t *out, int64_t threads) {
  Order order = {out, count, (uint64_t)key};
  in_parallel(some_places, &order, count, 4096, threads);
  return DONE;
}
