/* Crossover, mutation and parameters of children, one graph at a time (cgtorch.evolution.operators). Every
   choice is a function of numbered draws, so that C and torch make the same children. */
#pragma once
#include "draws.h"
#include "graph.h"
#include "real.h"

/* Inputs of breeding, and space for the children. */
typedef struct {
  Graphs given, made;           /* of `made` N is what children may have */
  const int64_t *elite;         /* (E,) of `given` */
  const int64_t *parents;       /* (2 Q,) of `given`, the first ones and then the second ones */
  const float *parent_strategy; /* (E + 2 Q, STRATEGY) of the elite and of parents */
  const uint8_t *has_edge;      /* (A, O), or NULL where nothing is mutated */
  int64_t elites, pairs, actions, pair_key, key;
  int64_t width; /* nodes of the largest of the elite and of parents */
} Breeding;

/* The first `size` nodes that an undirected breadth-first search from a random node meets. Draws, which begin
   at `jitter`, order nodes at the same distance. */
static void group_of(const Graph *graph, int o, int size, uint64_t key, int begin,
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
  uint64_t wave = bit(pick(uniform(key, begin), graph->count)), seen = wave;
  for (int count = 0; count < size;) {
    if (!wave) wave = graph->used & ~seen, seen = graph->used; /* unreachable nodes */
    int first = count, end = count, sorted[MOST_NODES];
    int64_t keys[MOST_NODES];
    uint64_t next = 0;
    for (; wave; wave &= wave - 1) {
      int node = first_bit(wave), at = end++;
      int64_t place = field(key, jitter + node);
      next |= near[node];
      for (; at > first && keys[at - 1] > place; at--) {
        keys[at] = keys[at - 1];
        sorted[at] = sorted[at - 1];
      }
      keys[at] = place;
      sorted[at] = node;
    }
    for (; count < end && count < size; count++) group[count] = sorted[count];
    wave = next & ~seen;
    seen |= wave;
  }
}

static void graft(Graph *child, const int *into, const Graph *donor, const int *taken, int size,
                  int o, uint64_t key, int heads) {
  int position[MOST_NODES];
  for (int i = 0; i < donor->count; i++) position[i] = NO_NODE;
  for (int p = 0; p < size; p++) position[taken[p]] = p;
  for (int p = 0; p < size; p++) {
    int old = taken[p], place = into[p];
    child->action[place] = donor->action[old];
    child->origin[place] = donor->origin[old];
    for (int j = 0; j < o; j++) {
      int head = donor->edges[old][j];
      if (head == NO_NODE) child->edges[place][j] = NO_NODE;
      else if (position[head] != NO_NODE) child->edges[place][j] = (int8_t)into[position[head]];
      else child->edges[place][j] = (int8_t)pick(uniform(key, heads + p * o + j), child->count);
    }
  }
}

/* The two children of a pair. */
static void cross(const Breeding *b, int64_t pair, Graph *one, Graph *two) {
  int o = (int)b->given.outcomes, w = (int)b->width, heads = 4 + 2 * w;
  int here[MOST_NODES], there[MOST_NODES];
  uint64_t key = key_of(b->pair_key, pair);
  const float *rate = b->parent_strategy + (b->elites + pair) * STRATEGY + CROSSOVER;
  float both = rate[0] + rate[b->pairs * STRATEGY];
  Graph first, second;
  read_graph(one, &b->given, b->parents[pair]);
  read_graph(two, &b->given, b->parents[b->pairs + pair]);
  if (!(both > 0)) return;
  int half = (one->count < two->count ? one->count : two->count) / 2;
  if (uniform(key, 0) < both / 2 && half > 0) {
    int size = 1 + pick(uniform(key, 1), half);
    group_of(one, o, size, key, 2, 4, here);
    group_of(two, o, size, key, 3, 4 + w, there);
    copy_graph(&first, one);
    copy_graph(&second, two);
    graft(one, here, &second, there, size, o, key, heads);
    graft(two, there, &first, here, size, o, key, heads + w * o);
  }
  prune(one, o);
  prune(two, o);
}

/* A random node other than `gone`. */
static int8_t other(const Graph *graph, int gone, float draw) {
  if (gone == NO_NODE) return (int8_t)pick(draw, graph->count);
  int k = pick(draw, graph->count - 1);
  return (int8_t)(k + (k >= gone));
}

static void renew(const Breeding *b, Graph *graph, int node, int action) {
  graph->action[node] = action;
  graph->origin[node] = 0;
  for (int64_t j = 0; j < b->made.outcomes; j++) graph->edges[node][j] = NO_NODE;
}

static void add_node(const Breeding *b, Graph *graph, float rate, uint64_t key) {
  int o = (int)b->made.outcomes, n = graph->count, spare = 0, into[MOST_NODES] = {0};
  if (!(uniform(key, 0) < rate) || n >= b->made.nodes) return;
  for (int i = 0; i < n; i++)
    for (int j = 0; j < o; j++)
      if (graph->edges[i][j] != NO_NODE) into[graph->edges[i][j]]++;
  for (int i = 0; i < n; i++)
    spare += into[i] >= 2 ? into[i] : 0;
  if (!spare) return;
  int k = pick(uniform(key, 1), spare);
  renew(b, graph, n, pick(uniform(key, 2), (int)b->actions));
  for (int j = 0; j < o; j++)
    if (b->has_edge[graph->action[n] * o + j]) graph->edges[n][j] = (int8_t)pick(uniform(key, 3 + j), n);
  for (int i = 0; i < n && k >= 0; i++)
    for (int j = 0; j < o && k >= 0; j++) {
      int head = graph->edges[i][j];
      if (head != NO_NODE && into[head] >= 2 && k-- == 0) graph->edges[i][j] = (int8_t)n;
    }
  graph->used |= bit(n);
  graph->count++;
}

/* Deletes a node and returns it; its draws begin at `at`, those of heads at `heads`. */
static int delete_node(Graph *graph, int o, float rate, uint64_t key, int at, int heads) {
  if (!(uniform(key, at) < rate) || graph->count <= 2) return NO_NODE;
  int gone = pick(uniform(key, at + 1), graph->count);
  for (int i = 0; i < graph->count; i++)
    for (int j = 0; j < o; j++)
      if (graph->edges[i][j] == gone)
        graph->edges[i][j] = other(graph, gone, uniform(key, heads + i * o + j));
  if (graph->start == gone) graph->start = other(graph, gone, uniform(key, at + 2));
  graph->used &= ~bit(gone);
  return gone;
}

/* Replaces nodes and changes edges, by draws that begin at `replaced`, `changed` and `heads`. */
static void change_nodes(const Breeding *b, Graph *graph, int gone, const float *rate,
                         uint64_t key, int replaced, int changed, int heads) {
  int o = (int)b->made.outcomes;
  for (uint64_t rest = graph->used; rest; rest &= rest - 1) {
    int i = first_bit(rest), leads = 0;
    int8_t *edges = graph->edges[i];
    float draw = uniform(key, replaced + i);
    if (draw < rate[REPLACE_NODE]) {
      renew(b, graph, i, pick(draw / rate[REPLACE_NODE], (int)b->actions));
      for (int j = 0; j < o; j++)
        if (b->has_edge[graph->action[i] * o + j])
          edges[j] = other(graph, gone, uniform(key, heads + i * o + j));
    }
    draw = uniform(key, changed + i);
    if (!(draw < rate[CHANGE_EDGE])) continue;
    for (int j = 0; j < o; j++) leads += edges[j] != NO_NODE;
    int k = pick(draw / rate[CHANGE_EDGE], leads);
    for (int j = 0; j < o; j++)
      if (edges[j] != NO_NODE && k-- == 0)
        edges[j] = other(graph, gone, uniform(key, heads + i * o + j));
  }
}

static void new_start(Graph *graph, int o, float rate, uint64_t key, int at) {
  int leading[MOST_NODES], count = 0;
  if (!(uniform(key, at) < rate)) return;
  for (uint64_t rest = graph->used; rest; rest &= rest - 1) {
    int i = first_bit(rest), leads = 0;
    for (int j = 0; j < o; j++) leads |= graph->edges[i][j] != NO_NODE && graph->edges[i][j] != i;
    if (leads) leading[count++] = i;
  }
  if (count) graph->start = leading[pick(uniform(key, at + 1), count)];
}

/* All mutations in turn for the child of that row. */
static void mutate(const Breeding *b, Graph *graph, int64_t row) {
  int o = (int)b->made.outcomes, w = (int)b->made.nodes;
  int deletes = 3 + o, starts = deletes + 3, replaced = starts + 2;
  int changed = replaced + w, heads = changed + w;
  const float *rate = b->parent_strategy + (b->elites + row) * STRATEGY;
  uint64_t key = key_of(b->key, row);
  add_node(b, graph, rate[ADD_NODE], key);
  int gone = delete_node(graph, o, rate[DELETE_NODE], key, deletes, heads);
  change_nodes(b, graph, gone, rate, key, replaced, changed, heads);
  new_start(graph, o, rate[NEW_START], key, starts);
}

/* Both children of a pair, mutated where there are actions, below the elite. */
static inline void make_pair(const Breeding *b, int64_t pair) {
  Graph child[2];
  cross(b, pair, &child[0], &child[1]);
  for (int i = 0; i < 2; i++) {
    int64_t row = i * b->pairs + pair;
    if (b->has_edge) mutate(b, &child[i], row);
    write_reached(&child[i], &b->made, b->elites + row);
  }
}
static inline void copy_elite(const Breeding *b, int64_t row) {
  Graph graph;
  read_graph(&graph, &b->given, b->elite[row]);
  write_reached(&graph, &b->made, row);
}

/* The first `same` individuals stay unchanged. */
typedef struct {
  const int64_t *action, *num_parameters; /* (P, N), and of each of so many actions */
  const int64_t *standard; /* (A,) whether parameters of new nodes are standard normal */
  const int64_t *origins; /* (P, N) r + 1 for row r of `old`, -r - 1 of `fresh`, 0 for those or none */
  const real *old, *fresh;
  const float *strategy; /* (P, STRATEGY) of parents */
  const float *bounds;   /* (2, STRATEGY) the least and the most */
  const float *quantiles; /* (1281, 3), cgtorch.ground.counter_rng.quantiles */
  real *parameters;       /* (P, N, K) */
  float *drifted;         /* (P, STRATEGY) */
  int64_t rows, nodes, most, actions, same, key; /* P, N, K, A */
  float spread; /* sqrt(tau) / log 2 */
} Children;

static inline int64_t parameters_at(const Children *c, int64_t slot) {
  int64_t action = c->action[slot];
  return action < 0 || action >= c->actions ? 0 : c->num_parameters[action];
}

/* The origin of a node's parameters; NULL if they are drawn. */
static inline const real *origin_of(const Children *c, int64_t slot) {
  int64_t origin = c->origins[slot];
  return !origin ? NULL : origin > 0 ? c->old + (origin - 1) * c->most : c->fresh + (-origin - 1) * c->most;
}
/* Number j of the parameters of a new node. */
static inline real fresh_number(const Children *c, uint64_t key, int64_t row, int64_t slot, int64_t j) {
  int64_t place = (slot - row * c->nodes) * c->most + j;
  return c->standard[c->action[slot]] ? normal(c->quantiles, word(key, FRESH + place)) : 0;
}

/* Strategies as they were, or with number i multiplied by exp(N(0, tau)), within its bounds (eq. 2). */
static inline float drifted(const Children *c, uint64_t key, int64_t row, int i) {
  float x = c->strategy[row * STRATEGY + i];
  if (row < c->same) return x;
  x *= power_of_two(normal(c->quantiles, word(key, DRIFT + i)) * c->spread);
  float least = c->bounds[i], most = c->bounds[STRATEGY + i];
  return x < least ? least : x > most ? most : x;
}
