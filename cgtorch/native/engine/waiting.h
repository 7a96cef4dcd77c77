/* Rollouts of any actions in any environment: lanes run until they need Python, and wait
   (cgtorch.simulation.resumable). Unlike in rollout.h, a vector contains lanes of any graphs, all at nodes of
   one kind. */
#pragma once
#include "lanes.h"

#define SHARE 1024 /* lanes that a thread takes at once, with queues of their own */

/* The position of a lane. */
typedef struct {
  int32_t node, first; /* rows of the table of nodes; `first` of the graph or sub-skill */
  int32_t left, step;  /* transitions left on this level; actions so far */
  int32_t level, idle; /* of sub-skills; actions in a row that left the state as it was */
  uint64_t visited;    /* a bit for each node it was at since anything has changed, on this level */
} Place;

/* The successor by an outcome: a row or an end, and the kind of the node there. */
typedef struct {
  int32_t head, kind;
} Successor;

/* Rollouts with T nodes and L = P * B lanes, which are rows of tensors. */
typedef struct {
  const Program *program;
  const ModelEnvironment *environment; /* or NULL where Python has the environment */
  const int64_t *memory;               /* (K, 2) where an action's part of the memory begins; its size */
  const int64_t *deterministic;        /* (K,) */
  int64_t graphs, count, max_transitions, max_steps;
  int64_t most_idle; /* actions in a row that may leave the state as it is; 0 for any number */

  const real *first_percept;          /* of as many lanes as `firsts`, in turn */
  const unsigned char *first_state;
  const int64_t *first_scenario;
  int64_t firsts;

  real *percept, *message, *common;   /* (L, D), (L, M), (L, C) memory */
  unsigned char *state, *has_message; /* (L, S) of any type, (L,) */
  int64_t *step;                      /* (L,) */
  int64_t percept_size, message_size, memory_size, state_bytes, state_is_real;

  int32_t *kinds; /* (T,) of all graphs' nodes, and then of those of sub-skills */
  Successor *successors;      /* (T, outcomes) */
  Place *places;  /* (L,) */
  int32_t *caller, *outer, *outer_first; /* (L, depth) */
  int32_t *queue;   /* (K, L) the lanes of each share that wait for each kind */
  int64_t *waiting; /* (shares, K) how many these are */
  int64_t *offset;  /* (shares,) the first row of those that Python was asked for */
  unsigned char *succeeded, *timed_out; /* (L,) */
  int64_t *executed;   /* (shares,) */

  /* The request to Python: an action, or -1 where all lanes have ended, and its number of lanes.
     Rows are copied unless these are all. */
  int64_t kind, asked, everyone, silent; /* `silent`: how many of them have no message */
  int64_t *asked_scenario, *asked_step;
  real *asked_percept, *asked_message, *asked_memory;
  unsigned char *asked_state, *asked_has;
  const int64_t *parameters, *held; /* (K,) addresses of (L, width) parameters, and of whose they are */

  /* The answer of Python: rows of tensors, NULL where nothing has changed, and outcomes as
     indices, as whether a control could be carried out, or as probabilities of success. */
  const real *new_percept, *new_message, *new_memory, *chance;
  const unsigned char *new_state, *new_has, *done;
  const int64_t *outcome;
  const unsigned char *over; /* 1 where an episode is over with success, 2 without; or NULL */
  int64_t wrong, num_wrong, wrong_outcome; /* of graphs; how many outcomes, and one of them */
} Waiting;

/* Requests the action for which most lanes wait (waiting.c). */
int ask_python(Waiting *w, int64_t threads);
