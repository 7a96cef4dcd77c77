/* Subgraphs of two parents swapped (cgtorch.evolution.crossover), one pair after the other. */
#include "draws.h"
#include "graph.h"
#include "parallel.h"

typedef struct {
  Graphs from, to;
  Shape shape;
  const int64_t *parents;        /* (2 Q,) of `from`, all that come first before the others */
  const int64_t *chosen, *sizes; /* (Q,) row of `draws` or -1, and how many nodes are swapped */
  const int64_t *draws;
  int64_t width, words, pairs;
} Crossover;

/* The first `size` nodes that an undirected breadth-first search from a random node meets, those of
   one distance in the order of their draws, which begin at `jitter`. */
static void group_of(const Graph *graph, int o, int size, const int64_t *words, int begin,
                     int jitter, int *group) {
  uint64_t near[MOST_NODES] = {0};
  for (int i = 0; i < graph->count; i++)
    for (int j = 0; j < o; j++) {
      int head = graph->edges[i][j];
      if (head == NO_NODE) continue;
      near[i] |= bit(head);
      near[head] |= bit(i);
    }
  uint64_t wave = bit(pick(uniform(words, begin), graph->count)), seen = wave;
  for (int count = 0; count < size;) {
    if (!wave) wave = graph->used & ~seen, seen = graph->used; /* no way leads to these */
    int first = count, end = count, sorted[MOST_NODES];
    int64_t keys[MOST_NODES];
    uint64_t next = 0;
    for (; wave; wave &= wave - 1) {
      int node = __builtin_ctzll(wave), at = end++;
      int64_t key = field(words, jitter + node);
      next |= near[node];
      for (; at > first && keys[at - 1] > key; at--) {
        keys[at] = keys[at - 1];
        sorted[at] = sorted[at - 1];
      }
      keys[at] = key;
      sorted[at] = node;
    }
    for (; count < end && count < size; count++) group[count] = sorted[count];
    wave = next & ~seen;
    seen |= wave;
  }
}

static void graft(Graph *child, const int *into, const Graph *donor, const int *taken, int size,
                  int o, const int64_t *words, int heads) {
  int position[MOST_NODES];
  for (int i = 0; i < donor->count; i++) position[i] = NO_NODE;
  for (int p = 0; p < size; p++) position[taken[p]] = p;
  for (int p = 0; p < size; p++) {
    int old = taken[p], new = into[p];
    child->action[new] = donor->action[old];
    child->mark[new] = donor->mark[old];
    for (int j = 0; j < o; j++) {
      int head = donor->edges[old][j];
      if (head == NO_NODE) child->edges[new][j] = NO_NODE;
      else if (position[head] != NO_NODE) child->edges[new][j] = into[position[head]];
      else child->edges[new][j] = pick(uniform(words, heads + p * o + j), child->count);
    }
  }
}

static void some_pairs(void *what, int64_t begin, int64_t end) {
  const Crossover *c = what;
  int o = (int)c->shape.outcomes;
  int w = (int)c->width, heads = 2 + 2 * w;
  Graph first, second, child;
  int here[MOST_NODES], there[MOST_NODES];
  for (int64_t row = begin; row < end; row++) {
    read_graph(&first, &c->from, c->shape, c->parents[row]);
    read_graph(&second, &c->from, c->shape, c->parents[c->pairs + row]);
    if (c->chosen[row] < 0) {
      write_reached(&first, &c->to, c->shape, row);
      write_reached(&second, &c->to, c->shape, c->pairs + row);
      continue;
    }
    const int64_t *words = c->draws + c->chosen[row] * c->words;
    int size = (int)c->sizes[row];
    group_of(&first, o, size, words, 0, 2, here);
    group_of(&second, o, size, words, 1, 2 + w, there);
    child = first;
    graft(&child, here, &second, there, size, o, words, heads);
    write_reached(&child, &c->to, c->shape, row);
    child = second;
    graft(&child, there, &first, here, size, o, words, heads + w * o);
    write_reached(&child, &c->to, c->shape, c->pairs + row);
  }
}

int crossed(const Graphs *from, const int64_t *parents, const Graphs *to, const int64_t *shape,
            const int64_t *chosen, const int64_t *sizes, const int64_t *draws, int64_t width,
            int64_t pairs, int64_t threads) {
  Shape of = {shape[0], shape[1]};
  int64_t words = words_for(2 + 2 * width * (1 + of.outcomes));
  Crossover c = {*from, *to, of, parents, chosen, sizes, draws, width, words, pairs};
  in_parallel(some_pairs, &c, pairs, 32, (int)threads);
  return 0;
}
