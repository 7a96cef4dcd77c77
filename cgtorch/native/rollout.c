/* Algorithm 3 in Γ and C: graph by graph, with a vector of lanes each time
   (cgtorch.simulation.compiled). */
#include "actions.h"
#include "follow.h"
#include "parallel.h"

#define PIECE 8 /* graphs that a thread takes at once */

INLINE vwhole first_lanes(int64_t count) {
  vwhole lanes;
  for (int i = 0; i < WIDTH; i++) lanes[i] = -(i < count);
  return lanes;
}

/* Runs a graph on a chunk's scenarios: lanes that wait at the same node go on together, until the last
   one has ended. */
static void run_lanes(const Task *task, Layout layout, int64_t number, const Chunk *chunk,
                      Lanes *lanes) {
  const Program *program = task->program;
  Graph graph = graph_of(program, number);
  vwhole active = first_lanes(chunk->count);
  copy_lanes(&chunk->lanes, layout.size, lanes);
  lanes->node = every((whole)(program->rows + program->start[number]));
  lanes->left = every((whole)task->max_transitions);
  if (program->depth > 1)
    for (int i = 0; i < WIDTH; i++) enter(program, graph, lanes, i);
  for (uint32_t waiting = bits_of(active); waiting; waiting = bits_of(active)) {
    int64_t node = lanes->node[__builtin_ctz(waiting)];
    vwhole here = active & (lanes->node == (whole)node);
    Done done = act(task, graph, layout, chunk->errors, lanes, node, here);
    vwhole second = here & done.second, other = here & ~done.second;
    if (bits_of(other)) active &= ~follow(task, graph, lanes, node, 0, other, done.changed);
    if (bits_of(second)) active &= ~follow(task, graph, lanes, node, 1, second, done.changed);
  }
}

/* Whether a graph can be run; what cannot be is said at the end. */
INLINE int good(Task *task, int64_t graph) {
  int wrong = wrong_graph(task->program, graph);
  if (wrong) __atomic_store_n(&task->wrong, 1, __ATOMIC_RELAXED);
  return !wrong;
}

enum { NO_MEMORY = 1, WRONG_GRAPHS = 2 };

typedef struct {
  Task *task;
  const Chunk *chunks;
  int64_t count;
} Rollouts;

static void run_graphs(void *what, int64_t begin, int64_t end) {
  const Rollouts *r = what;
  Task *task = r->task;
  Layout layout = layout_of(task->models->size);
  Lanes lanes;
  vec *state[3] = {&lanes.moves, &lanes.lost, &lanes.chance};
  for (int64_t graph = begin; graph < end; graph++) {
    if (!good(task, graph)) continue;
    for (const Chunk *chunk = r->chunks; chunk < r->chunks + r->count; chunk++) {
      int64_t row = graph * task->count + chunk->from;
      run_lanes(task, layout, graph, chunk, &lanes);
      into_rows(lanes.percept, chunk->count, layout.size, task->percept + row * layout.size);
      for (int i = 0; i < chunk->count; i++) {
        task->status[row + i] = lanes.status[i];
        task->transitions[row + i] = lanes.step[i];
        for (int j = 0; j < 3; j++) task->state[(row + i) * 3 + j] = (*state[j])[i];
      }
    }
  }
}

/* 0, or why nothing of what comes out counts. */
int rollouts(Task *task, int64_t threads) {
  Rollouts r = {task, NULL, 0};
  Chunk *chunks = chunks_of(task, 0, &r.count);
  if (!chunks) return NO_MEMORY;
  r.chunks = chunks;
  in_parallel(run_graphs, &r, task->graphs, PIECE, task->ticks ? 1 : threads);
  free(chunks);
  return task->wrong ? WRONG_GRAPHS : 0;
}

/* Eq. 3; of `task` only what there is to do is read, and its scenarios are those of W, `keep` of them,
   and then those of M. */
typedef struct {
  Task task;
  int64_t keep;
  float *fitness;           /* (P,) */
  real *score;              /* (P, B) */
  unsigned char *succeeded; /* (P, B) */
  int64_t transitions;      /* that all graphs make */
  int64_t not_finite;       /* graphs with a number that is none; nothing of what they did counts */
  const Chunk *chunks;
  int64_t count; /* of chunks */
} Evaluation;

/* What one graph came to. */
typedef struct {
  real *score;
  unsigned char *succeeded;
  int64_t transitions;
  int finite, lost;
} Came;

INLINE int all_finite(const real *x, int64_t count) {
  real total = 0; /* 0 times what is not finite is not a number */
#pragma omp simd reduction(+ : total)
  for (int64_t i = 0; i < count; i++) total += x[i] * 0;
  return total == 0;
}

#define LANES 8
#define SUMS 4

/* The mean of numbers in the order of cgtorch.numerics.row_means. */
static float mean_of(const real *x, int64_t count) {
  float sums[SUMS][LANES] = {{0}}, total = 0;
  int64_t lanes = count < LANES ? 1 : LANES, groups = count / lanes, even = groups / SUMS * SUMS;
  for (int64_t g = 0; g < groups; g++)
    for (int64_t i = 0; i < lanes; i++) sums[g < even ? g % SUMS : 0][i] += (float)x[g * lanes + i];
  for (int s = 1; s < SUMS; s++)
    for (int64_t i = 0; i < lanes; i++) sums[0][i] += sums[s][i];
  for (int64_t i = groups * lanes; i < count; i++) total += (float)x[i];
  for (int64_t i = 0; i < lanes; i++) total += sums[0][i];
  return total / (float)count;
}

/* Runs a graph on a chunk's scenarios. */
static void evaluate_chunk(const Task *task, Layout layout, int64_t graph, const Chunk *chunk,
                           int64_t keep, Came *came) {
  Lanes lanes;
  run_lanes(task, layout, graph, chunk, &lanes);
  ask_chance(task, layout, &lanes, first_lanes(chunk->count));
  vwhole finite = finite_vec(lanes.chance), success = lanes.status == SUCCESS;
  for (int i = 0; i < layout.size; i++) finite &= finite_vec(lanes.percept[i]);
  vec c = vec_max(all(0), vec_min(all(1), lanes.chance));
  c = select_vec(finite, select_vec(success, c, c / 2), all(0));
  for (int i = 0; i < chunk->count; i++) {
    came->score[lanes.scenario[i]] = c[i];
    came->succeeded[lanes.scenario[i]] = success[i] != 0;
    came->finite &= finite[i] != 0;
    came->transitions += lanes.step[i];
    came->lost |= chunk->from < keep && !success[i];
  }
}

static void evaluate_graphs(void *what, int64_t begin, int64_t end) {
  Evaluation *e = what;
  const Program *program = e->task.program;
  Layout layout = layout_of(e->task.models->size);
  int64_t numbers = program->nodes * program->each, scenarios = e->task.count;
  int64_t transitions = 0, not_finite = 0;
  for (int64_t graph = begin; graph < end; graph++) {
    Came came = {e->score + graph * scenarios, e->succeeded + graph * scenarios, 0, 0, 0};
    if (!good(&e->task, graph)) continue;
    came.finite = all_finite(program->parameters + graph * numbers, numbers);
    memset(came.succeeded, 0, (size_t)scenarios);
    for (const Chunk *chunk = e->chunks; chunk < e->chunks + e->count; chunk++)
      if (!came.lost || chunk->from < e->keep)
        evaluate_chunk(&e->task, layout, graph, chunk, e->keep, &came);
    if (came.lost || !came.finite) memset(came.score, 0, (size_t)scenarios * sizeof(real));
    if (!came.finite) memset(came.succeeded, 0, (size_t)scenarios);
    e->fitness[graph] = mean_of(came.score, scenarios);
    transitions += came.transitions, not_finite += !came.finite;
  }
  __atomic_fetch_add(&e->transitions, transitions, __ATOMIC_RELAXED);
  __atomic_fetch_add(&e->not_finite, not_finite, __ATOMIC_RELAXED);
}

/* Like `rollouts`. */
int evaluations(Evaluation *e, int64_t threads) {
  Chunk *chunks = chunks_of(&e->task, e->keep, &e->count);
  if (!chunks) return NO_MEMORY;
  e->chunks = chunks;
  in_parallel(evaluate_graphs, e, e->task.graphs, PIECE, e->task.ticks ? 1 : threads);
  free(chunks);
  return e->task.wrong ? WRONG_GRAPHS : 0;
}

/* The clock that `ticks` are of, and (2, PARTS) ticks and counts of `times` readings of nothing. */
int clock_now(int64_t *ticks) {
  *ticks = now();
  return 0;
}
int clock_alone(int64_t *ticks, int64_t times) {
  for (int64_t i = 0; i < times; i++) TIMED(ticks, i % PARTS, );
  return 0;
}
