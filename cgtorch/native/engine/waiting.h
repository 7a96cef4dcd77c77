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

#define NODES_SEEN 64 /* that `visited` can tell apart; in loops over more all transitions are made */

INLINE int64_t kinds_of(const Waiting *w) { return w->program->count; }

INLINE uint64_t seen_bit(int32_t place) { return (uint64_t)1 << (place & (NODES_SEEN - 1)); }

APART void enter_skills(const Waiting *w, int64_t i) {
  const Program *p = w->program;
  Place *at = w->places + i;
  int32_t own = (int32_t)(w->graphs * p->nodes), skill;
  while ((skill = w->kinds[at->node] - (int32_t)p->count) >= 0) {
    int64_t level = i * p->depth + at->level++;
    w->outer[level] = at->left, w->outer_first[level] = at->first;
    w->caller[level + 1] = at->node;
    at->left = (int32_t)p->limit[skill];
    at->node = own + (int32_t)p->entry[skill];
    at->first = own + (int32_t)p->began[skill];
    at->visited = 0;
  }
}

/* Leaves the sub-skills that end with `head`, and enters the next ones; returns how the lane ended, or 0. */
APART int32_t leave_skills(const Waiting *w, int64_t i, int32_t head) {
  const Program *p = w->program;
  Place *at = w->places + i;
  while (head < 0 && at->level > 0) {
    /* A sub-skill's first outcome is success, its second failure; a timeout is a failure. */
    int64_t level = i * p->depth + at->level--;
    head = w->successors[w->caller[level] * p->outcomes + (head != SUCCESS)].head;
    at->left = w->outer[level - 1] - 1, at->first = w->outer_first[level - 1];
    if (head >= 0 && at->left <= 0) head = TIMEOUT;
  }
  if (head < 0) return head;
  at->visited = 0;
  at->node = head;
  enter_skills(w, i);
  return 0;
}

/* The common values of the walks of many lanes. */
typedef struct {
  const Waiting *waiting;
  const Successor *successors;
  Place *places;
  int64_t outcomes, count, depth, max_steps, most_idle;
} Walk;

INLINE Walk walk_of(const Waiting *w) {
  const Program *p = w->program;
  return MAKE(Walk){w,           w->successors,      w->places,   p->outcomes, p->count,
                p->depth, w->max_steps, w->most_idle};
}

/* `call_stack.advance`: returns the kind of the lane's next node, or -1 if it ends, which is recorded.
   `changed`: whether anything on which a later action could depend has changed. For `over` see Waiting. */
INLINE int32_t walk(const Walk *v, int64_t i, int64_t outcome, int changed, int state_changed,
                    int over) {
  Place *at = v->places + i;
  Successor successor = v->successors[at->node * v->outcomes + outcome];
  int32_t left = at->left - 1, skipped = 0, end = successor.head < 0 ? successor.head : 0, step = at->step + 1;
  int enters = 0;
  if (successor.head >= 0) { /* in an unchanged state again, only the limit of transitions ends the lane */
    uint64_t bit = seen_bit(successor.head - at->first);
    enters = successor.kind >= v->count;
    int32_t apart = (successor.head - at->first) ^ (at->node - at->first);
    int same = !changed & !enters & (apart < NODES_SEEN);
    if (same & ((at->visited & bit) != 0)) skipped = left, left = 0;
    end = left <= 0 ? TIMEOUT : 0;
    at->visited = (same ? at->visited : 0) | bit;
    at->node = successor.head;
  }
  at->left = left;
  if (v->depth > 1) {
    if (end && at->level > 0) end = leave_skills(v->waiting, i, end), successor.kind = -1;
    else if (!end && enters) enter_skills(v->waiting, i), successor.kind = -1;
    if (successor.kind < 0 && !end) successor.kind = v->waiting->kinds[at->node];
  }
  step += skipped;
  int last = step >= v->max_steps;
  if (last & (skipped > 0)) end = TIMEOUT;
  if (v->most_idle) {
    at->idle = state_changed ? 0 : at->idle + 1;
    if (!end && at->idle > v->most_idle) end = TIMEOUT;
  }
  if (over) end = over == 1 ? SUCCESS : FAILURE;
  at->step = last ? (int32_t)v->max_steps : step;
  if (!(last | (end != 0))) return successor.kind;
  v->waiting->succeeded[i] = end == SUCCESS;
  v->waiting->timed_out[i] = end != SUCCESS && end != FAILURE;
  v->waiting->step[i] = at->step;
  return -1;
}

/* One of two vectors whose numbers change places where bit B of their index says so: of rows and
   columns of a square that are 2^B apart, the two squares beside its diagonal. */
#define KEPT(j, B) ((j) >> (B) & 1 ? WIDTH + ((j) ^ (1 << (B))) : (j))
#define GIVEN(j, B) ((j) >> (B) & 1 ? WIDTH + (j) : ((j) ^ (1 << (B))))
#define SWAPPED(v, rows, B)                                    \
  UNROLLED for (int r = 0; r < (rows); r++) {                  \
    if (r >> (B) & 1) continue;                                \
    vec low = v[r], high = v[r + (1 << (B))];                  \
    v[r] = SHUFFLED(low, high, KEPT, B);                       \
    v[r + (1 << (B))] = SHUFFLED(low, high, GIVEN, B);         \
  }

/* Of two halves of vectors, each a square of its own, rows become columns. */
INLINE void transpose_halves(vec *v, int rows) {
  SWAPPED(v, rows, 0)
#if WIDTH > 4
  SWAPPED(v, rows, 1)
#endif
#if WIDTH > 8
  SWAPPED(v, rows, 2)
#endif
}
INLINE void transpose(vec *v) {
  transpose_halves(v, WIDTH);
#if WIDTH == 16
  SWAPPED(v, WIDTH, 3)
#elif WIDTH == 8
  SWAPPED(v, WIDTH, 2)
#else
  SWAPPED(v, WIDTH, 1)
#endif
}

#ifdef __AVX512DQ__
#define HALF_WIDTH (WIDTH / 2)
/* Up to half a vector's numbers of two rows, side by side. */
INLINE vec load_two(const real *a, const real *b, int count) {
#ifdef REAL_IS_FLOAT
  __mmask8 part = (__mmask8)((1u << count) - 1);
  return (vec)_mm512_insertf32x8(_mm512_castps256_ps512(_mm256_maskz_loadu_ps(part, a)),
                                 _mm256_maskz_loadu_ps(part, b), 1);
#else
  __mmask8 part = (__mmask8)((1u << count) - 1);
  return (vec)_mm512_insertf64x4(_mm512_castpd256_pd512(_mm256_maskz_loadu_pd(part, a)),
                                 _mm256_maskz_loadu_pd(part, b), 1);
#endif
}
#endif

/* `count` numbers of each of WIDTH rows. */
INLINE void into_columns_of(const real *const *rows, int count, vec *columns) {
  int j = 0;
  for (; j + WIDTH <= count; j += WIDTH) {
    vec square[WIDTH];
    UNROLLED for (int i = 0; i < WIDTH; i++) square[i] = load(rows[i] + j);
    transpose(square);
    UNROLLED for (int i = 0; i < WIDTH; i++) columns[j + i] = square[i];
  }
#ifdef __AVX512DQ__
  for (; j < count; j += HALF_WIDTH) {
    vec halves[WIDTH / 2];
    int here = count - j < HALF_WIDTH ? count - j : HALF_WIDTH;
    UNROLLED for (int i = 0; i < HALF_WIDTH; i++)
      halves[i] = load_two(rows[i] + j, rows[i + HALF_WIDTH] + j, here);
    transpose_halves(halves, HALF_WIDTH);
    for (int i = 0; i < here; i++) columns[j + i] = halves[i];
  }
#else
  for (; j < count; j++)
    for (int i = 0; i < WIDTH; i++) columns[j][i] = rows[i][j];
#endif
}

/* Copies a row; returns whether any number differs. */
INLINE int copied_row(const real *from, real *to, int64_t size) {
  int other = 0;
#ifdef __AVX512DQ__ /* without a loop for the rest of a vector */
  for (int64_t j = 0; j < size; j += WIDTH) {
    uint32_t part = size - j < WIDTH ? (1u << (size - j)) - 1 : (uint32_t)((1ull << WIDTH) - 1);
#ifdef REAL_IS_FLOAT
    __m512 now = _mm512_maskz_loadu_ps((__mmask16)part, from + j);
    other |= _mm512_mask_cmp_ps_mask((__mmask16)part, now,
                                     _mm512_maskz_loadu_ps((__mmask16)part, to + j), _CMP_NEQ_UQ);
    _mm512_mask_storeu_ps(to + j, (__mmask16)part, now);
#else
    __m512d now = _mm512_maskz_loadu_pd((__mmask8)part, from + j);
    other |= _mm512_mask_cmp_pd_mask((__mmask8)part, now,
                                     _mm512_maskz_loadu_pd((__mmask8)part, to + j), _CMP_NEQ_UQ);
    _mm512_mask_storeu_pd(to + j, (__mmask8)part, now);
#endif
  }
#else
  for (int64_t j = 0; j < size; j++) other |= to[j] != from[j], to[j] = from[j];
#endif
  return other != 0;
}
