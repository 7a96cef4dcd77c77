/* What rollouts are made of: programs, models, and a vector of lanes that run one graph. */
#ifndef CGTORCH_LANES_H
#define CGTORCH_LANES_H
#include "models.h"

#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define SUCCESS (-1)
#define TIMEOUT (-3)
#define UNKNOWN (-1)

enum { MOVE_BASE, DETECT, GRASP, CONTINUOUS, BRANCHING, EDGE, EDGE_BRANCHING };
enum { IN_GAMMA, IN_C, IN_NETWORKS, IN_POSSIBLE, PARTS };

typedef struct {
  int64_t kind, inputs, hidden, outputs;
} Action;

/* cgtorch.simulation.program.Program */
typedef struct {
  const Action *actions;
  const int64_t *kind, *heads, *start, *entry, *limit;
  const real *parameters;
  int64_t primitives, outcomes, width, depth, nodes; /* slots of each graph */
} Program;

/* cgtorch.simulation.ModelEnvironment */
typedef struct {
  Gamma gamma;
  Classifier classifier;
  Body body;
  const real *percepts, *state, *errors; /* (B, D), (B, 3), (B, T, D) or NULL */
  int64_t size, turns;
  real most_novel;
} Models;

/* What there is to do: P graphs on `count` scenarios; and what comes out, (P * count, ...). */
typedef struct {
  const Program *program;
  const Models *models;
  const int64_t *scenarios;
  int64_t graphs, count, max_transitions, max_steps;
  real *percept, *state;
  int64_t *status, *transitions;
  int64_t *ticks; /* (2, PARTS) or NULL: clock ticks spent in each part, and how often it was timed */
} Task;

/* Up to WIDTH lanes of one graph. Each part of a vector is one lane's, and none meets another. */
typedef struct {
  whole caller[MOST_DEPTH][WIDTH], outer[MOST_DEPTH][WIDTH]; /* what is left on the levels without */
  vec message[MOST_MESSAGE], moves, lost, chance;            /* the state of `ModelEnvironment` */
  vwhole spoken;                                             /* whether there is a message */
  vwhole scenario, step, node, level, left; /* `left`: transitions on this level */
  vwhole been; /* a bit for each node it was at since anything has changed, on this level */
  vwhole status;
  vec percept[MOST_PERCEPT];
} Lanes;

INLINE int64_t now(void) {
#if defined(__x86_64__)
  return (int64_t)__builtin_ia32_rdtsc();
#elif defined(__aarch64__)
  int64_t ticks;
  __asm__ volatile("mrs %0, cntvct_el0" : "=r"(ticks));
  return ticks;
#else
  return 0;
#endif
}
#define TIMED(ticks, part, what)                                           \
  do {                                                                     \
    int64_t before = (ticks) ? now() : 0;                                  \
    what;                                                                  \
    if (ticks) (ticks)[part] += now() - before, (ticks)[PARTS + (part)]++; \
  } while (0)

/* Lanes at the beginning of scenarios, as many as there are and WIDTH at most. */
INLINE void begin_lanes(const Models *m, const int64_t *scenarios, int64_t count, Lanes *lanes) {
  vec *state[3] = {&lanes->moves, &lanes->lost, &lanes->chance};
  for (int i = 0; i < WIDTH; i++) {
    int64_t scenario = scenarios[i < count ? i : 0];
    lanes->scenario[i] = (whole)scenario;
    for (int j = 0; j < m->size; j++) lanes->percept[j][i] = m->percepts[scenario * m->size + j];
    for (int j = 0; j < 3; j++) (*state[j])[i] = m->state[scenario * 3 + j];
  }
  for (int j = 0; j < MOST_MESSAGE; j++) lanes->message[j] = all(0);
  lanes->spoken = lanes->step = lanes->level = lanes->been = lanes->status = every(0);
}
/* The same once more; of the levels without nothing is known at the beginning. */
INLINE void copy_lanes(const Lanes *from, int size, Lanes *to) {
  size_t skipped = offsetof(Lanes, message), end = offsetof(Lanes, percept) + (size_t)size * BYTES;
  memcpy((char *)to + skipped, (const char *)from + skipped, end - skipped);
}
#endif
