/* Subgraphs of two parents swapped (cgtorch.evolution.crossover). */
#ifndef CGTORCH_CROSSOVER_H
#define CGTORCH_CROSSOVER_H
#include "draws.h"
#include "graph.h"

typedef struct {
  Graphs from;
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
  uint64_t near[MOST_NODES];
  memset(near, 0, (size_t)graph->count * sizeof *near);
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
      else if (position[head] != NO_NODE) child->edges[new][j] = (int8_t)into[position[head]];
      else child->edges[new][j] = (int8_t)pick(uniform(words, heads + p * o + j), child->count);
    }
  }
}

/* Two children of the parents of a pair. */
static void cross(const Crossover *c, int64_t pair, Graph *one, Graph *two) {
  int o = (int)c->shape.outcomes, w = (int)c->width, heads = 2 + 2 * w, size = (int)c->sizes[pair];
  int here[MOST_NODES], there[MOST_NODES];
  Graph first, second;
  read_graph(one, &c->from, c->shape, c->parents[pair]);
  read_graph(two, &c->from, c->shape, c->parents[c->pairs + pair]);
  if (c->chosen[pair] >= 0) {
    const int64_t *words = c->draws + c->chosen[pair] * c->words;
    group_of(one, o, size, words, 0, 2, here);
    group_of(two, o, size, words, 1, 2 + w, there);
    copy_graph(&first, one);
    copy_graph(&second, two);
    graft(one, here, &second, there, size, o, words, heads);
    graft(two, there, &first, here, size, o, words, heads + w * o);
  }
  prune(one, o);
  prune(two, o);
}
#endif
