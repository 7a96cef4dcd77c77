/* One computational graph at a time: its nodes in order, without the unused slots between them. */
#pragma once
#ifndef __CUDACC_RTC__
#include <stdint.h>
#include <string.h>
#endif

#define NO_NODE (-1)
#define MOST_NODES 64 /* sets of nodes are the bits of one word */
#define MOST_OUTCOMES 16

/* Tensors (P, N), (P, N, O), (P, N, 1) and (P,) of cgtorch.graphs.Graphs. In place of parameters a
   node carries their origin (cgtorch.evolution.parameters), which without any is 1 + its place among
   all slots. */
typedef struct {
  int64_t *action, *edges, *origins, *start;
  int64_t nodes, outcomes; /* N and O */
} Graphs;

typedef struct {
  int count, start; /* nodes; those that are gone leave a hole */
  uint64_t used;    /* which of them are there */
  int64_t origin[MOST_NODES + 1];
  int32_t action[MOST_NODES + 1];
  int8_t edges[MOST_NODES][MOST_OUTCOMES]; /* to nodes */
} Graph;

/* The number of the lowest bit that is set. */
#ifdef __CUDACC__
static inline int first_bit(uint64_t bits) { return __ffsll((long long)bits) - 1; }
#else
static inline int first_bit(uint64_t bits) { return __builtin_ctzll(bits); }
#endif
static inline uint64_t bit(int i) { return (uint64_t)1 << i; }
static inline uint64_t first_bits(int count) { return count < 64 ? bit(count) - 1 : ~(uint64_t)0; }

static inline void read_graph(Graph *graph, const Graphs *from, int64_t row) {
  int64_t n = from->nodes, o = from->outcomes, slot[MOST_NODES + 1];
  const int64_t *action = from->action + row * n, *edges = from->edges + row * n * o;
  int8_t place[MOST_NODES] = {0};
  int count = 0;
  /* Without branches, which CPUs could not predict: an unused slot is overwritten by the next node. */
  for (int64_t i = 0; i < n; i++) {
    int used = action[i] != NO_NODE;
    place[i] = (int8_t)(used ? count : NO_NODE);
    slot[count] = i;
    graph->action[count] = (int32_t)action[i];
    count += used;
  }
  for (int i = 0; i < count; i++) {
    int64_t at = row * n + slot[i];
    graph->origin[i] = from->origins ? from->origins[at] : at + 1;
  }
  for (int i = 0; i < count; i++) {
    const int64_t *heads = edges + slot[i] * o;
    for (int64_t j = 0; j < o; j++)
      graph->edges[i][j] = heads[j] < 0 || heads[j] >= n ? NO_NODE : place[heads[j]];
  }
  int64_t start = from->start[row];
  graph->start = start < 0 || start >= n ? NO_NODE : place[start];
  graph->count = count;
  graph->used = first_bits(count);
}

/* The nodes that the start leads to. */
static inline uint64_t reached(const Graph *graph, int outcomes) {
  uint64_t seen = graph->start == NO_NODE ? 0 : bit(graph->start), wave = seen;
  while (wave) {
    uint64_t next = 0;
    for (; wave; wave &= wave - 1) {
      const int8_t *heads = graph->edges[first_bit(wave)];
      for (int j = 0; j < outcomes; j++)
        if (heads[j] != NO_NODE) next |= bit(heads[j]);
    }
    wave = next & ~seen;
    seen |= wave;
  }
  return seen;
}

/* Removes nodes that the start does not lead to; the others move up in their order. */
static inline void prune(Graph *graph, int outcomes) {
  uint64_t kept = reached(graph, outcomes);
  int8_t place[MOST_NODES];
  int count = 0;
  if (kept == graph->used && kept == first_bits(graph->count)) return;
  for (uint64_t rest = kept; rest; rest &= rest - 1) place[first_bit(rest)] = (int8_t)count++;
  for (uint64_t rest = kept; rest; rest &= rest - 1) {
    int old = first_bit(rest), to = place[old];
    graph->origin[to] = graph->origin[old];
    graph->action[to] = graph->action[old];
    for (int j = 0; j < outcomes; j++) {
      int head = graph->edges[old][j];
      graph->edges[to][j] = head == NO_NODE ? NO_NODE : place[head];
    }
  }
  if (graph->start != NO_NODE) graph->start = place[graph->start];
  graph->count = count;
  graph->used = first_bits(count);
}

/* Copies the used nodes. */
static inline void copy_graph(Graph *to, const Graph *from) {
  size_t count = (size_t)from->count;
  to->count = from->count;
  to->start = from->start;
  to->used = from->used;
  memcpy(to->origin, from->origin, count * sizeof *to->origin);
  memcpy(to->action, from->action, count * sizeof *to->action);
  memcpy(to->edges, from->edges, count * sizeof *to->edges);
}

/* Writes the nodes that the start leads to into the first slots. */
static inline void write_reached(Graph *graph, const Graphs *to, int64_t row) {
  int64_t n = to->nodes, o = to->outcomes, count;
  int64_t *action = to->action + row * n, *edges = to->edges + row * n * o;
  int64_t *origins = to->origins + row * n;
  prune(graph, (int)o);
  count = graph->count;
  for (int64_t i = 0; i < count; i++) {
    action[i] = graph->action[i];
    origins[i] = graph->origin[i];
    for (int64_t j = 0; j < o; j++) edges[i * o + j] = graph->edges[i][j];
  }
  for (int64_t i = count; i < n; i++) action[i] = NO_NODE, origins[i] = 0;
  for (int64_t i = count * o; i < n * o; i++) edges[i] = NO_NODE;
  to->start[row] = graph->start;
}
