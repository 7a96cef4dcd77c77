/* A vector of lanes, and the task of rollouts in models with its results. */
#pragma once
#include "models.h"

/* Up to WIDTH lanes. Each part of a vector belongs to one lane; lanes are independent. */
typedef struct {
  whole caller[MOST_DEPTH][WIDTH], outer[MOST_DEPTH][WIDTH]; /* what is left on the levels without */
  vec message[MOST_MESSAGE], moves, lost, chance;            /* the state of `ModelEnvironment` */
  vwhole has_message;                                        /* whether there is a message */
  vwhole scenario, step, node, level, left; /* `left`: transitions on this level */
  vwhole executed; /* of `step` those that were made, not only counted */
  vwhole visited;  /* a bit for each node it was at since anything has changed, on this level */
  vwhole status;
  vec percept[MOST_PERCEPT];
} Lanes;

/* Copies lanes; outer levels need no values at the beginning. */
INLINE void copy_lanes(const Lanes *from, int size, Lanes *to) {
  const char *first = (const char *)from->message, *end = (const char *)(from->percept + size);
  memcpy((char *)to->message, first, (size_t)(end - first));
}

/* Up to WIDTH scenarios: their initial lanes, and the errors of Γ (T, D) for each. */
typedef struct {
  int64_t from, count;
  const vec *errors;
  Lanes lanes;
} Chunk;

/* P graphs on `count` scenarios, of which the first `keep` are W. Results are (P, B, ...): the second group
   of fields for rollouts, the third for evaluations. */
typedef struct {
  const Program *program;
  const ModelEnvironment *environment;
  const int64_t *scenarios;
  int64_t graphs, count, keep, max_transitions, max_steps;
  const int64_t *again; /* (PARTS,) how often more each part is done, by which it can be timed; or NULL */

  real cost; /* of a transition, as a share of the value of a rollout */

  real *percept, *state;
  int64_t *status, *transitions;

  float *fitness; /* (P,) */
  real *score;
  unsigned char *succeeded;
  int64_t counted, executed; /* transitions of evaluations, and those that were made, of both */
  int64_t not_finite;        /* graphs with NaN, whose results do not count */

  int64_t wrong; /* set where a graph has an invalid node or action */
  const Chunk *chunks;
  int64_t num_chunks;
} Task;

INLINE int all_finite(const real *x, int64_t count) {
  real total = 0; /* 0 times infinity is NaN */
#pragma omp simd reduction(+ : total)
  for (int64_t i = 0; i < count; i++) total += x[i] * 0;
  return total == 0;
}

#define MEAN_LANES 8
#define SUMS 4

/* The mean of numbers in the order of cgtorch.ground.numerics.row_means. */
INLINE float mean_of(const real *x, int64_t count) {
  float sums[SUMS][MEAN_LANES] = {{0}}, total = 0;
  int64_t lanes = count < MEAN_LANES ? 1 : MEAN_LANES, groups = count / lanes;
  int64_t even = groups / SUMS * SUMS;
  for (int64_t g = 0; g < groups; g++)
    for (int64_t i = 0; i < lanes; i++) sums[g < even ? g % SUMS : 0][i] += (float)x[g * lanes + i];
  for (int s = 1; s < SUMS; s++)
    for (int64_t i = 0; i < lanes; i++) sums[0][i] += sums[s][i];
  for (int64_t i = groups * lanes; i < count; i++) total += (float)x[i];
  for (int64_t i = 0; i < lanes; i++) total += sums[0][i];
  return total / (float)count;
}

/* The arguments of kernels beside the task: scenarios [begin, end) of each graph are run, by at most `most`
   threads of each warp. */
typedef struct {
  int32_t *lost, *bad; /* (P,) whether a graph has lost W; BAD_NUMBERS, NOT_FINITE or 0 */
  int64_t *counts;     /* of the enum below */
  int64_t begin, end, most;
} Launch;

enum { BAD_NUMBERS = 1, NOT_FINITE = 2 };
enum { NEXT_OF_W, NEXT, COUNTED, EXECUTED, NUM_NOT_FINITE, WRONG, COUNTS };
