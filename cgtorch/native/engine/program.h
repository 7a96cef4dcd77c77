/* Graphs as tensors, with the sub-skills that they use (cgtorch.simulation.compiled). Nodes count from the
   first of all sub-skills, which are stored once; after these come the nodes of the graph that runs. */
#pragma once
#include "real.h"

/* Sizes that compiled code supports. Larger ones run in torch. For a GPU, sizes are those needed. */
#ifndef MOST_DEPTH
#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define MOST_PERCEPT 64
#define MOST_HIDDEN 64
#endif
#define MOST_READ 400 /* numbers of a percept that networks read which only resumable.h runs */
#define MOST_SENT 32 /* numbers of a message that these send */
#define MOST_DELAYED (4 * MOST_READ) /* numbers of a percept and its changes */
#define MOST_SEEN (MOST_PERCEPT + 9) /* numbers that a network reads */
#define MOST_COLUMNS (MOST_HIDDEN * (MOST_SEEN + 1) + MOST_MESSAGE * (MOST_HIDDEN + 1))

/* RECURRENT and DELAY have a memory, which only the lanes of resumable.h have. Inputs and outputs of
   the kinds DOMAIN_... are mapped by the code of a domain. */
enum {
  STEP, PERCEIVE, TEST, CONTINUOUS, BRANCHING, DOMAIN_NN, DOMAIN_OTHER_NN, DOMAIN_BRANCHING, RECURRENT,
  DELAY, IN_PYTHON
};
enum { IN_GAMMA, IN_C, IN_NETWORKS, IN_POSSIBLE, PARTS };

#define NO_NODE (-1)
#define SUCCESS (-1)
#define FAILURE (-2)
#define TIMEOUT (-3)

/* `outputs`: of an action that Python runs, its parameters. */
typedef struct {
  int64_t kind, inputs, hidden, delays, outputs;
} Action;
#ifdef INPUTS /* where all networks have the same sizes, which for a GPU is known */
#define INPUTS_OF(action) INPUTS
#define HIDDEN_OF(action) HIDDEN
#else
#define INPUTS_OF(action) (int)(action)->inputs
#define HIDDEN_OF(action) (int)(action)->hidden
#endif

typedef struct {
  const Action *primitives;
  const int64_t *kinds, *ends; /* (A,) of each action, and (A, O) where its outcomes end */
  const int64_t *kind, *heads; /* of sub-skills' nodes: (T,), (T, outcomes) */
  const int64_t *entry, *began, *limit; /* (S,) starts of sub-skills, their first nodes, their limits */
  const real *learned;                         /* (T, width) their parameters */
  int64_t actions, most, count, outcomes, width, rows, depth; /* A, O, of primitives; T */
  const int64_t *action, *edges, *start; /* of graphs: (P, N), (P, N, seen), (P,) */
  const real *parameters;                /* (P, N, each) */
  int64_t nodes, seen, each;
} Program;

/* One of a program's graphs: where its rows begin, and what counts from there. */
typedef struct {
  const int64_t *action, *edges;
  const real *parameters;
} GraphRows;

INLINE GraphRows graph_of(const Program *p, int64_t graph) {
  int64_t row = graph * p->nodes;
  return MAKE(GraphRows){p->action + row, p->edges + row * p->seen, p->parameters + row * p->each};
}

/* Unused slots count as action 0; in a valid graph nothing leads there. */
INLINE int64_t action_at(GraphRows g, int64_t place) { return g.action[place] < 0 ? 0 : g.action[place]; }

/* A primitive, or `count` + a sub-skill. */
INLINE int64_t kind_of(const Program *p, GraphRows g, int64_t node) {
  return node < p->rows ? p->kind[node] : p->kinds[action_at(g, node - p->rows)];
}
INLINE int64_t head_of(const Program *p, GraphRows g, int64_t node, int64_t outcome) {
  int64_t place = node - p->rows;
  if (place < 0) return p->heads[node * p->outcomes + outcome];
  if (outcome >= p->seen) return FAILURE;
  int64_t head = g.edges[place * p->seen + outcome];
  return head == NO_NODE ? p->ends[action_at(g, place) * p->most + outcome] : p->rows + head;
}
INLINE const real *parameters_of_node(const Program *p, GraphRows g, int64_t node) {
  int64_t place = node - p->rows;
  return place < 0 ? p->learned + node * p->width : g.parameters + place * p->each;
}

INLINE int outside(int64_t number, int64_t count) { return number < NO_NODE || number >= count; }

/* Whether all numbers of a graph are valid nodes or actions; if not, `wrong` is set. */
INLINE int good(const Program *p, int64_t graph, int64_t *wrong) {
  GraphRows g = graph_of(p, graph);
  int bad = p->start[graph] < 0 || p->start[graph] >= p->nodes;
  for (int64_t i = 0; i < p->nodes; i++) bad |= outside(g.action[i], p->actions);
  for (int64_t i = 0; i < p->nodes * p->seen; i++) bad |= outside(g.edges[i], p->nodes);
  if (bad) SET(wrong);
  return !bad;
}
