/* What rollouts are made of: programs, models, and a vector of lanes that run one graph. */
#pragma once
#include <stdlib.h>

#include "tabletop/models.h"
#include "program.h"

#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define UNKNOWN (-1)

enum { MOVE_BASE, DETECT, GRASP, CONTINUOUS, BRANCHING, EDGE, EDGE_BRANCHING };
enum { IN_GAMMA, IN_C, IN_NETWORKS, IN_POSSIBLE, PARTS };

/* cgtorch.simulation.ModelEnvironment */
typedef struct {
  Gamma gamma;
  Classifier classifier;
  Body body;
  const real *percepts, *state, *errors; /* (B, D), (B, 3), (B, T, D) or NULL */
  int64_t size, turns;
  real most_novel;
} Models;

/* Up to WIDTH lanes of one graph. Each part of a vector is one lane's, and none meets another. */
typedef struct {
  whole caller[MOST_DEPTH][WIDTH], outer[MOST_DEPTH][WIDTH]; /* what is left on the levels without */
  vec message[MOST_MESSAGE], moves, lost, chance;            /* the state of `ModelEnvironment` */
  vwhole has_message;                                             /* whether there is a message */
  vwhole scenario, step, node, level, left; /* `left`: transitions on this level */
  vwhole visited; /* a bit for each node it was at since anything has changed, on this level */
  vwhole status;
  vec percept[MOST_PERCEPT];
} Lanes;

/* Does a part as often as it is asked for more than once; the results are the same. */
#define PART(again, part, what)                              \
  for (int64_t left = (again) ? 1 + (again)[part] : 1; left > 0; left--) { \
    what;                                                    \
    __asm__ volatile("" ::: "memory"); /* or it would be done once */      \
  }

/* Some scenarios, WIDTH at most: the lanes at their beginnings, and as many errors of Γ (T, D). */
typedef struct {
  int64_t from, count;
  const vec *errors;
  Lanes lanes;
} Chunk;

/* What there is to do: P graphs on `count` scenarios, of which the first `keep` are those of W. What
   comes out is (P, B, ...), of `rollouts` the second, of `evaluations` the third group of fields. */
typedef struct {
  const Program *program;
  const Models *models;
  const int64_t *scenarios;
  int64_t graphs, count, keep, max_transitions, max_steps;
  const int64_t *again; /* (PARTS,) how often more each part is done, by which it can be timed; or NULL */

  real *percept, *state;
  int64_t *status, *transitions;

  float *fitness; /* (P,) */
  real *score;
  unsigned char *succeeded;
  int64_t executed;   /* transitions that all graphs make */
  int64_t not_finite; /* graphs with a number that is none; nothing of what they did counts */

  int64_t wrong; /* set where a graph has numbers that are none of its nodes or actions */
  const Chunk *chunks;
  int64_t num_chunks;
} Task;

INLINE void fill_chunk(const Models *m, const int64_t *scenarios, Chunk *chunk, vec *errors) {
  Lanes *lanes = &chunk->lanes;
  vec *state[3] = {&lanes->moves, &lanes->lost, &lanes->chance};
  int64_t each = m->errors ? m->turns * m->size : 0;
  memset(lanes, 0, sizeof *lanes);
  for (int i = 0; i < WIDTH; i++) {
    int64_t scenario = scenarios[chunk->from + (i < chunk->count ? i : 0)];
    lanes->scenario[i] = (whole)scenario;
    for (int64_t j = 0; j < m->size; j++) lanes->percept[j][i] = m->percepts[scenario * m->size + j];
    for (int j = 0; j < 3; j++) (*state[j])[i] = m->state[scenario * 3 + j];
    for (int64_t j = 0; j < each; j++) errors[j][i] = m->errors[scenario * each + j];
  }
  chunk->errors = errors;
}

/* The scenarios of W in chunks, and then the others; NULL without memory for it, else to be freed. */
static Chunk *chunks_of(Task *task) {
  const Models *m = task->models;
  int64_t rest = task->count - task->keep, each = m->errors ? m->turns * m->size : 0, from = 0;
  int64_t count = (task->keep + WIDTH - 1) / WIDTH + (rest + WIDTH - 1) / WIDTH;
  size_t head = (size_t)count * sizeof(Chunk);
  Chunk *chunks = malloc(head + (size_t)(count * each) * BYTES + 1);
  for (int64_t c = 0; c < count && chunks; c++) {
    int64_t left = (from < task->keep ? task->keep : task->count) - from;
    chunks[c].from = from, chunks[c].count = left < WIDTH ? left : WIDTH;
    fill_chunk(m, task->scenarios, chunks + c, (vec *)((char *)chunks + head) + c * each);
    from += chunks[c].count;
  }
  task->chunks = chunks, task->num_chunks = count;
  return chunks;
}
/* The same once more; of the levels without nothing is known at the beginning. */
INLINE void copy_lanes(const Lanes *from, int size, Lanes *to) {
  size_t skipped = offsetof(Lanes, message), end = offsetof(Lanes, percept) + (size_t)size * BYTES;
  memcpy((char *)to + skipped, (const char *)from + skipped, end - skipped);
}
