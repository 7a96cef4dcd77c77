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

/* Lanes that wait at the same node go on together, until the last of `count` has ended. */
static void run_lanes(const Task *task, Layout layout, int64_t graph, int64_t count, Lanes *lanes) {
  const Program *program = task->program;
  int64_t first = graph * program->nodes;
  vwhole active = first_lanes(count);
  lanes->node = every((whole)program->start[graph]);
  lanes->left = every((whole)task->max_transitions);
  if (program->depth > 1)
    for (int i = 0; i < WIDTH; i++) enter(program, lanes, i);
  for (uint32_t waiting = bits_of(active); waiting; waiting = bits_of(active)) {
    int64_t node = lanes->node[__builtin_ctz(waiting)];
    vwhole here = active & (lanes->node == (whole)node);
    Done done = act(task, layout, lanes, node, here);
    vwhole second = here & done.second, other = here & ~done.second;
    if (bits_of(other)) active &= ~follow(task, lanes, first, node, 0, other, done.changed);
    if (bits_of(second)) active &= ~follow(task, lanes, first, node, 1, second, done.changed);
  }
}

static int64_t at_most(int64_t count) { return count < WIDTH ? count : WIDTH; }

static void run_graphs(void *what, int64_t begin, int64_t end) {
  const Task *task = what;
  Layout layout = layout_of(task->models->size);
  Lanes at, lanes;
  for (int64_t from = 0; from < task->count; from += WIDTH) {
    int64_t count = at_most(task->count - from);
    begin_lanes(task->models, task->scenarios + from, count, &at);
    for (int64_t graph = begin; graph < end; graph++) {
      int64_t row = graph * task->count + from;
      vec *state[3] = {&lanes.moves, &lanes.lost, &lanes.chance};
      copy_lanes(&at, layout.size, &lanes);
      run_lanes(task, layout, graph, count, &lanes);
      into_rows(lanes.percept, count, layout.size, task->percept + row * layout.size);
      for (int i = 0; i < count; i++) {
        task->status[row + i] = lanes.status[i];
        task->transitions[row + i] = lanes.step[i];
        for (int j = 0; j < 3; j++) task->state[(row + i) * 3 + j] = (*state[j])[i];
      }
    }
  }
}

int rollouts(Task *task, int64_t threads) {
  in_parallel(run_graphs, task, task->graphs, PIECE, task->ticks ? 1 : (int)threads);
  return 0;
}

/* Eq. 3; of `task` only what there is to do is read, and its scenarios are those of W, `keep` of them,
   and then those of M. */
typedef struct {
  Task task;
  int64_t keep;
  real *score;              /* (P, B) */
  unsigned char *succeeded; /* (P, B) */
  unsigned char *finite;    /* (P,) */
  int64_t *transitions;     /* (P,) */
} Evaluation;

INLINE int all_finite(const real *x, int64_t count) {
  real total = 0; /* 0 times what is not finite is not a number */
#pragma omp simd reduction(+ : total)
  for (int64_t i = 0; i < count; i++) total += x[i] * 0;
  return total == 0;
}

/* Runs a graph on `count` scenarios; whether it has succeeded on all of them. */
static int evaluate_lanes(const Evaluation *e, Layout layout, int64_t graph, int64_t count,
                          const Lanes *at) {
  const Task *task = &e->task;
  Lanes lanes;
  copy_lanes(at, layout.size, &lanes);
  run_lanes(task, layout, graph, count, &lanes);
  ask_chance(task, layout, &lanes, first_lanes(count));
  vwhole finite = finite_vec(lanes.chance);
  for (int i = 0; i < layout.size; i++) finite &= finite_vec(lanes.percept[i]);
  vec c = vec_max(all(0), vec_min(all(1), lanes.chance));
  vwhole success = lanes.status == SUCCESS;
  c = select_vec(finite, select_vec(success, c, c / 2), all(0));
  int solved = 1;
  for (int i = 0; i < count; i++) {
    int64_t place = graph * task->count + lanes.scenario[i];
    e->score[place] = c[i];
    e->succeeded[place] = success[i] != 0;
    e->finite[graph] &= finite[i] != 0;
    e->transitions[graph] += lanes.step[i];
    solved &= success[i] != 0;
  }
  return solved;
}

static void evaluate_graphs(void *what, int64_t begin, int64_t end) {
  const Evaluation *e = what;
  const Task *task = &e->task;
  Layout layout = layout_of(task->models->size);
  int64_t numbers = task->program->nodes * task->program->width;
  unsigned char lost[PIECE] = {0};
  Lanes at;
  for (int64_t graph = begin; graph < end; graph++) {
    e->transitions[graph] = 0;
    e->finite[graph] = (unsigned char)all_finite(task->program->parameters + graph * numbers, numbers);
  }
  for (int64_t from = 0, to = 0; from < task->count; from = to) {
    int64_t limit = from < e->keep ? e->keep : task->count, count = at_most(limit - from);
    to = from + count;
    begin_lanes(task->models, task->scenarios + from, count, &at);
    for (int64_t graph = begin; graph < end; graph++)
      if (from < e->keep)
        lost[graph - begin] |= !evaluate_lanes(e, layout, graph, count, &at);
      else if (!lost[graph - begin])
        evaluate_lanes(e, layout, graph, count, &at);
  }
  for (int64_t graph = begin; graph < end; graph++)
    if (lost[graph - begin])
      memset(e->score + graph * task->count, 0, (size_t)task->count * sizeof(real));
}

int evaluations(Evaluation *e, int64_t threads) {
  in_parallel(evaluate_graphs, e, e->task.graphs, PIECE, e->task.ticks ? 1 : (int)threads);
  return 0;
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
