/* Mutations of nodes and edges (cgtorch.evolution.structure) of one graph. Every choice is a function
   of numbers drawn before, so that both ways make the same children. */
#ifndef CGTORCH_MUTATION_H
#define CGTORCH_MUTATION_H
#include "draws.h"
#include "graph.h"

/* Columns of the strategy, and of the draws before those of each node (cgtorch.evolution). */
enum { ADD_NODE = 1, DELETE_NODE, NEW_START, REPLACE_NODE, CHANGE_EDGE, STRATEGY = 8 };

typedef struct {
  Shape shape;
  const float *strategy;
  const int64_t *draws;
  int64_t words, width; /* of the draws: in all, and nodes that each has one of */
  const uint8_t *has_edge;
  int64_t actions;
} Mutation;

/* A random one of the nodes that are there, all but `gone`. */
static int8_t other(const Graph *graph, int gone, float draw) {
  if (gone == NO_NODE) return (int8_t)pick(draw, graph->count);
  int k = pick(draw, graph->count - 1);
  return (int8_t)(k + (k >= gone));
}

static void renew(const Mutation *m, Graph *graph, int node, int action) {
  graph->action[node] = action;
  graph->mark[node] = 0;
  for (int64_t j = 0; j < m->shape.outcomes; j++) graph->edges[node][j] = NO_NODE;
}

static void add_node(const Mutation *m, Graph *graph, float rate, const int64_t *words) {
  int o = (int)m->shape.outcomes, n = graph->count, spare = 0, into[MOST_NODES] = {0};
  if (!(uniform(words, 0) < rate) || n >= m->shape.nodes) return;
  for (int i = 0; i < n; i++)
    for (int j = 0; j < o; j++)
      if (graph->edges[i][j] != NO_NODE) into[graph->edges[i][j]]++;
  for (int i = 0; i < n; i++)
    spare += into[i] >= 2 ? into[i] : 0;
  if (!spare) return;
  int k = pick(uniform(words, 1), spare), free = 0;
  renew(m, graph, n, pick(uniform(words, 2), (int)m->actions));
  for (int j = 0; j < o; j++)
    if (m->has_edge[graph->action[n] * o + j]) graph->edges[n][j] = (int8_t)pick(uniform(words, 3 + j), n);
  for (int i = 0; i < n && k >= 0; i++)
    for (int j = 0; j < o && k >= 0; j++) {
      int head = graph->edges[i][j];
      if (head != NO_NODE && into[head] >= 2 && k-- == 0) graph->edges[i][j] = (int8_t)n;
    }
  while (free < n && graph->slot[free] == free) free++; /* slots ascend: the first gap */
  graph->slot[n] = (int8_t)free;
  graph->used |= bit(n);
  graph->count++;
}

/* Returns the node that is gone; its draws begin at `at`, those of heads at `heads`. */
static int delete_node(Graph *graph, int o, float rate, const int64_t *words, int at, int heads) {
  if (!(uniform(words, at) < rate) || graph->count <= 2) return NO_NODE;
  int gone = pick(uniform(words, at + 1), graph->count);
  for (int i = 0; i < graph->count; i++)
    for (int j = 0; j < o; j++)
      if (graph->edges[i][j] == gone)
        graph->edges[i][j] = other(graph, gone, uniform(words, heads + i * o + j));
  if (graph->start == gone) graph->start = other(graph, gone, uniform(words, at + 2));
  graph->used &= ~bit(gone);
  return gone;
}

/* Nodes replaced, and edges changed, by draws that begin at `replaced`, `changed` and `heads`. */
static void change_nodes(const Mutation *m, Graph *graph, int gone, const float *rate,
                         const int64_t *words, int replaced, int changed, int heads) {
  int o = (int)m->shape.outcomes;
  for (uint64_t rest = graph->used; rest; rest &= rest - 1) {
    int i = __builtin_ctzll(rest), leads = 0;
    int8_t *edges = graph->edges[i];
    float draw = uniform(words, replaced + i);
    if (draw < rate[REPLACE_NODE]) {
      renew(m, graph, i, pick(draw / rate[REPLACE_NODE], (int)m->actions));
      for (int j = 0; j < o; j++)
        if (m->has_edge[graph->action[i] * o + j])
          edges[j] = other(graph, gone, uniform(words, heads + i * o + j));
    }
    draw = uniform(words, changed + i);
    if (!(draw < rate[CHANGE_EDGE])) continue;
    for (int j = 0; j < o; j++) leads += edges[j] != NO_NODE;
    int k = pick(draw / rate[CHANGE_EDGE], leads);
    for (int j = 0; j < o; j++)
      if (edges[j] != NO_NODE && k-- == 0)
        edges[j] = other(graph, gone, uniform(words, heads + i * o + j));
  }
}

static void new_start(Graph *graph, int o, float rate, const int64_t *words, int at) {
  int leading[MOST_NODES], count = 0;
  if (!(uniform(words, at) < rate)) return;
  for (uint64_t rest = graph->used; rest; rest &= rest - 1) {
    int i = __builtin_ctzll(rest), leads = 0;
    for (int j = 0; j < o; j++) leads |= graph->edges[i][j] != NO_NODE && graph->edges[i][j] != i;
    if (leads) leading[count++] = i;
  }
  if (count) graph->start = leading[pick(uniform(words, at + 1), count)];
}

/* All of them in turn for the individual of that row. */
static void mutate(const Mutation *m, Graph *graph, int64_t row) {
  int o = (int)m->shape.outcomes, w = (int)m->width;
  int deletes = 3 + o, starts = deletes + 3, replaced = starts + 2;
  int changed = replaced + w, heads = changed + w;
  const float *rate = m->strategy + row * STRATEGY;
  const int64_t *words = m->draws + row * m->words;
  add_node(m, graph, rate[ADD_NODE], words);
  int gone = delete_node(graph, o, rate[DELETE_NODE], words, deletes, heads);
  change_nodes(m, graph, gone, rate, words, replaced, changed, heads);
  new_start(graph, o, rate[NEW_START], words, starts);
}
#endif
