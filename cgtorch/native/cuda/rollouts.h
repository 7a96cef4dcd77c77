/* Algorithm 3 on a GPU: a thread runs a lane of any graph to its end and then takes another one. Each thread
   evaluates networks by itself; the threads of a warp evaluate Γ and C together. Include it where the models
   are defined (engine/models.h), with sizes as constants (cgtorch.simulation.gpu_engine). */
#pragma once
#include "engine/actions.h"

#define REFILL 8 /* threads without a lane from which a search for new ones pays off */

/* The position of a thread. */
typedef struct {
  GraphRows graph;
  const vec *errors;
  int64_t number, place; /* of the graph, and among the scenarios */
  bool active, ended;
} Run;

INLINE int64_t taken(const Launch *launch, int count) {
  unsigned long long first = 0, *next = (unsigned long long *)launch->counts + (launch->begin ? NEXT : NEXT_OF_W);
  if (thread_of_warp() == 0) first = atomicAdd(next, (unsigned long long)count);
  return (int64_t)__shfl_sync(EVERYONE, first, 0);
}

INLINE void begin_lane(const Task *task, const Run *run, Layout layout, Lanes *lanes) {
  const ModelEnvironment *m = task->environment;
  int64_t scenario = task->scenarios[run->place];
  for (int i = 0; i < layout.size; i++) lanes->percept[i] = m->percepts[scenario * layout.size + i];
  lanes->moves = m->state[scenario * 3];
  lanes->lost = m->state[scenario * 3 + 1];
  lanes->chance = m->state[scenario * 3 + 2];
  UNROLLED for (int i = 0; i < MOST_MESSAGE; i++) lanes->message[i] = vec_of(0);
  lanes->has_message = lanes->step = lanes->level = lanes->visited = every(0);
  lanes->executed = lanes->status = every(0);
  lanes->scenario = every((whole)scenario);
  lanes->node = every((whole)(task->program->rows + task->program->start[run->number]));
  lanes->left = every((whole)task->max_transitions);
  if (task->program->depth > 1) enter(task->program, run->graph, lanes, 0);
}

/* New lanes for the threads of a warp that have none; whether there may be more. */
template <bool EVALUATES>
INLINE bool refilled(const Task *task, const Launch *launch, Layout layout, uint32_t idle, Run *run,
                     Lanes *lanes) {
  int me = thread_of_warp();
  int64_t each = launch->end - launch->begin, total = task->graphs * each;
  int64_t first = taken(launch, __popc(idle)), mine = first + __popc(idle & ((1u << me) - 1));
  if (idle >> me & 1 && mine < total) {
    run->number = mine / each, run->place = launch->begin + mine % each;
    bool bad = launch->bad[run->number] & BAD_NUMBERS;
    if (!bad && !(EVALUATES && run->place >= task->keep && launch->lost[run->number])) {
      int64_t scenario = task->scenarios[run->place];
      const ModelEnvironment *m = task->environment;
      run->graph = graph_of(task->program, run->number);
      run->errors = m->errors ? (const vec *)(m->errors + scenario * m->error_draws * m->size) : NULL;
      begin_lane(task, run, layout, lanes);
      run->active = true, run->ended = false;
    }
  }
  return first + __popc(idle) < total;
}

INLINE void write_rollout(const Task *task, const Run *run, Layout layout, const Lanes *lanes) {
  int64_t row = run->number * task->count + run->place;
  for (int i = 0; i < layout.size; i++) task->percept[row * layout.size + i] = lanes->percept[i][0];
  task->state[row * 3] = lanes->moves[0];
  task->state[row * 3 + 1] = lanes->lost[0];
  task->state[row * 3 + 2] = lanes->chance[0];
  task->status[row] = lanes->status[0];
  task->transitions[row] = lanes->step[0];
}
INLINE void write_worth(const Task *task, const Launch *launch, const Run *run, Layout layout,
                        const Lanes *lanes) {
  vwhole finite;
  int64_t row = run->number * task->count + lanes->scenario[0];
  bool success = lanes->status[0] == SUCCESS;
  task->score[row] = worth(layout, lanes, task->cost, &finite)[0];
  task->succeeded[row] = success;
  if (!finite[0]) launch->bad[run->number] = NOT_FINITE;
  if (run->place < task->keep && !success) launch->lost[run->number] = 1;
}

/* One action of each thread's lane that has not ended; and C for those that have, where it counts. */
template <bool EVALUATES>
INLINE Done one_action(const Task *task, Layout layout, const Run *run, Lanes *lanes) {
  const Program *program = task->program;
  const ModelEnvironment *m = task->environment;
  Done done = {every(0), every(0)};
  int kind = -1;
  if (run->active && !run->ended) {
    const Action *action = program->primitives + kind_of(program, run->graph, lanes->node[0]);
    kind = (int)action->kind;
    if (kind >= CONTINUOUS) {
      vec out[MOST_MESSAGE];
      answer(action, parameters_of_node(program, run->graph, lanes->node[0]), m->models, layout,
             lanes->percept, every(-1), out);
      done = apply_output(action, out, lanes, every(-1));
    }
  }
  __syncwarp();
  bool drives = kind == STEP, asks = kind == TEST || (EVALUATES && run->active && run->ended);
  if (any_of(drives)) {
    vwhole moved = move(m, NULL, layout, lanes, every(-drives));
    if (m->errors) add_errors(m, run->errors, lanes, moved);
    if (drives) done = MAKE(Done){~moved, moved};
  }
  if (any_of(asks)) {
    vwhole asked = ask_chance(m, NULL, layout, lanes, every(-asks));
    if (asks) done = MAKE(Done){lanes->chance <= (real)0.5, asked};
  }
  return done;
}

INLINE void add_up(int64_t *to, int64_t mine) {
  UNROLLED for (int by = WARP / 2; by; by /= 2) mine += __shfl_xor_sync(EVERYONE, mine, by);
  if (thread_of_warp() == 0) atomicAdd((unsigned long long *)to, (unsigned long long)mine);
}

template <bool EVALUATES> INLINE void run_lanes(const Task *task, const Launch *launch) {
  const Layout layout = layout_of(task->environment->size);
  Lanes lanes;
  Run run = {};
  bool more = true, allowed = thread_of_warp() < launch->most;
  int64_t counted = 0, executed = 0;
  for (;;) {
    uint32_t idle = __ballot_sync(EVERYONE, !run.active && allowed);
    bool any = __any_sync(EVERYONE, run.active);
    if (more && (__popc(idle) >= REFILL || !any)) {
      more = refilled<EVALUATES>(task, launch, layout, idle, &run, &lanes);
      any = __any_sync(EVERYONE, run.active);
    }
    if (!any && !more) break;
    if (!any) continue;
    Done done = one_action<EVALUATES>(task, layout, &run, &lanes);
    if (!run.active) continue;
    bool over = run.ended || !EVALUATES; /* C was evaluated, or need not be */
    if (!run.ended)
      run.ended = advance(task, run.graph, &lanes, lanes.node[0], done.second[0] != 0, every(-1), done.changed)[0];
    if (!run.ended || !over) continue;
    if (EVALUATES) write_worth(task, launch, &run, layout, &lanes);
    else write_rollout(task, &run, layout, &lanes);
    counted += lanes.step[0], executed += lanes.executed[0];
    run.active = false;
  }
  add_up(launch->counts + COUNTED, counted);
  add_up(launch->counts + EXECUTED, executed);
}

/* Machines in the shared memory of a block, if they fit. */
INLINE const real *brought(const real *from, int64_t count, real **to) {
  real *here = *to;
  for (int64_t i = threadIdx.x; i < count; i += blockDim.x) here[i] = from[i];
  *to += count;
  return here;
}
INLINE void bring(Machine *f, real **to) {
  f->centres = brought(f->centres, f->m * f->d, to);
  f->weights = brought(f->weights, f->m * f->k, to);
}

/* Sizes that are the same in all launches of these models and actions, as constants. */
INLINE void know_sizes(Program *p, ModelEnvironment *e, Machine *gamma, Machine *classifier) {
  e->size = MOST_PERCEPT, e->controls = CONTROLS;
  p->depth = DEPTH, p->rows = ROWS, p->count = PRIMITIVES;
  p->outcomes = OUTCOMES, p->most = ACTION_OUTCOMES, p->width = WIDTH_OF_SKILLS;
  gamma->m = GAMMA_CENTRES, gamma->d = GAMMA_FEATURES, gamma->k = GAMMA_OUTPUTS;
  classifier->m = CLASSIFIER_CENTRES, classifier->d = CLASSIFIER_FEATURES, classifier->k = 1;
}

DYNAMIC_SHARED real shared[];

template <bool EVALUATES>
INLINE void run_all(Task task, Program program, ModelEnvironment environment, Models models, Launch launch,
                    int share) {
  real *to = shared;
  know_sizes(&program, &environment, &models.GAMMA, &models.CLASSIFIER);
  if (share) bring(&models.GAMMA, &to), bring(&models.CLASSIFIER, &to);
  __syncthreads();
  environment.models = &models, task.program = &program, task.environment = &environment;
  run_lanes<EVALUATES>(&task, &launch);
}

#define ARGUMENTS                                                                      \
  const __grid_constant__ Task task, const __grid_constant__ Program program,          \
      const __grid_constant__ ModelEnvironment environment, const __grid_constant__ Models models, \
      const __grid_constant__ Launch launch, const int share

KERNEL __launch_bounds__(THREADS, BLOCKS) rollouts(ARGUMENTS) {
  run_all<false>(task, program, environment, models, launch, share);
}
KERNEL __launch_bounds__(THREADS, BLOCKS) evaluations(ARGUMENTS) {
  run_all<true>(task, program, environment, models, launch, share);
}

/* One warp per graph: whether its numbers are valid nodes and actions and, if parameters count, finite. */
KERNEL check(const __grid_constant__ Program program, const __grid_constant__ Launch launch, const int64_t graphs,
             const int parameters_count) {
  int64_t number = ((int64_t)blockIdx.x * blockDim.x + threadIdx.x) / WARP;
  if (number >= graphs) return;
  const Program *p = &program;
  GraphRows g = graph_of(p, number);
  int me = thread_of_warp(), wrong = p->start[number] < 0 || p->start[number] >= p->nodes;
  real total = 0;
  for (int64_t i = me; i < p->nodes; i += WARP) wrong |= outside(g.action[i], p->actions);
  for (int64_t i = me; i < p->nodes * p->seen; i += WARP) wrong |= outside(g.edges[i], p->nodes);
  if (parameters_count)
    for (int64_t i = me; i < p->nodes * p->each; i += WARP) total += g.parameters[i] * 0;
  wrong = __any_sync(EVERYONE, wrong);
  int bad = __any_sync(EVERYONE, !(total == 0));
  if (me) return;
  launch.lost[number] = 0, launch.bad[number] = (wrong ? BAD_NUMBERS : 0) | (bad ? NOT_FINITE : 0);
  if (wrong) launch.counts[WRONG] = 1;
}

/* One thread per graph: its fitness; its results do not count if a number is not finite. */
KERNEL fitness(const __grid_constant__ Task task, const __grid_constant__ Launch launch) {
  int64_t number = (int64_t)blockIdx.x * blockDim.x + threadIdx.x, count = task.count;
  if (number >= task.graphs) return;
  real *score = task.score + number * count;
  int bad = launch.bad[number] != 0, lost = launch.lost[number] != 0;
  for (int64_t i = 0; i < count && (bad || lost); i++) score[i] = 0;
  for (int64_t i = 0; i < count && bad; i++) task.succeeded[number * count + i] = 0;
  if (bad) atomicAdd((unsigned long long *)launch.counts + NUM_NOT_FINITE, 1ull);
  task.fitness[number] = mean_of(score, count);
}
