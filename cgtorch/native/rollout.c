/* Algorithm 3 in Γ and C: every graph on every scenario, one lane at a time from start to end
   (cgtorch.simulation.compiled). */
#include "models.h"
#include "parallel.h"

#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define MOST_HIDDEN 64
#define MOST_BEEN 32 /* in longer loops every transition is made */
#define PIECE 8 /* graphs that a thread takes at once */
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
  int64_t primitives, outcomes, width, depth;
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
  int64_t *ticks; /* (PARTS,) or NULL: clock ticks spent in each part, with one thread only */
} Task;

typedef struct {
  real percept[MOST_PERCEPT], state[3], message[MOST_MESSAGE];
  int has_message;
  int64_t scenario, step, node, level;
  int64_t been[MOST_BEEN], places; /* nodes it was at since anything has changed, on this level */
  int64_t caller[MOST_DEPTH], left[MOST_DEPTH];
} Lane;

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
#define TIMED(part, what)                                  \
  do {                                                     \
    int64_t before = task->ticks ? now() : 0;              \
    what;                                                  \
    if (task->ticks) task->ticks[part] += now() - before;  \
  } while (0)

/* A network with one hidden layer, `one_hidden_layer`. */
INLINE void layers(const real *x, const real *w, int inputs, int hidden, int outputs, real *out) {
  real at[MOST_HIDDEN];
  const real *b1 = w + hidden * inputs, *w2 = b1 + hidden, *b2 = w2 + outputs * hidden;
  for (int i = 0; i < hidden; i++) {
    real total = 0;
    for (int j = 0; j < inputs; j++) total += w[i * inputs + j] * x[j];
    at[i] = total + b1[i];
  }
  for (int i = 0; i < hidden; i += WIDTH) sigmoids(at + i, hidden - i < WIDTH ? hidden - i : WIDTH);
  for (int i = 0; i < outputs; i++) {
    real total = 0;
    for (int j = 0; j < hidden; j++) total += w2[i * hidden + j] * at[j];
    out[i] = total + b2[i];
  }
}
INLINE void network(const real *x, const real *w, const Action *a, int outputs, real *out) {
  if (a->hidden == 3 && a->inputs == 7) layers(x, w, 7, 3, outputs, out);
  else if (a->hidden == 3 && a->inputs == 9) layers(x, w, 9, 3, outputs, out);
  else layers(x, w, (int)a->inputs, (int)a->hidden, outputs, out);
}
INLINE int64_t branch(real *out) {
  sigmoids(out, 2);
  return out[1] > out[0];
}

INLINE void say(Lane *lane, const real *said, int64_t count, int *changed) {
  *changed = !lane->has_message;
  for (int64_t i = 0; i < count; i++) *changed |= lane->message[i] != said[i];
  memcpy(lane->message, said, (size_t)count * sizeof(real));
  lane->has_message = 1;
}

/* What takes long is kept out of the loop over transitions, whose registers it would take. */
#define APART static __attribute__((noinline))

/* `ModelEnvironment.step`, for a lane that has a message and is not lost: 1 where it has moved. */
APART int move(const Task *task, Layout layout, Lane *lane) {
  const Models *m = task->models;
  const real *u = lane->message;
  int possible = 0;
  TIMED(IN_POSSIBLE, possible = motion_possible(lane->percept, u, layout, &m->body));
  if (!possible) return 0;
  real after[MOST_PERCEPT], novelty;
  TIMED(IN_GAMMA, gamma_row(&m->gamma, layout, lane->percept, u, after, &novelty));
  memcpy(lane->percept, after, (size_t)layout.size * sizeof(real));
  if (m->errors) {
    int64_t look = (int64_t)lane->state[0] % m->turns;
    const real *error = m->errors + (lane->scenario * m->turns + look) * layout.size;
    for (int i = 0; i < layout.size; i++) lane->percept[i] += error[i];
  }
  int lost = novelty > m->most_novel;
  lane->state[0] += 1;
  lane->state[1] = (real)lost;
  lane->state[2] = lost ? 0 : UNKNOWN;
  return 1;
}

APART real chance(const Task *task, Layout layout, const real *percept) {
  real found = 0;
  TIMED(IN_C, found = success_row(&task->models->classifier, layout, percept));
  return found;
}

APART void continuous(const Task *task, Lane *lane, const Action *action, const real *weights,
                      int *changed) {
  real out[MOST_MESSAGE];
  TIMED(IN_NETWORKS, network(lane->percept, weights, action, (int)action->outputs, out));
  say(lane, out, action->outputs, changed);
}

APART int64_t branching(const Task *task, const Lane *lane, const Action *action,
                        const real *weights) {
  real out[2];
  TIMED(IN_NETWORKS, network(lane->percept, weights, action, 2, out));
  return branch(out);
}

APART void edge_network(const Task *task, Layout layout, Lane *lane, const Action *action,
                        const real *weights, int *changed) {
  real seen[SCENE], pose[3], out[3];
  TIMED(IN_NETWORKS, {
    Edge edge = edge_frame(lane->percept, layout);
    table_scene(&edge, lane->percept, seen);
    network(seen, weights, action, 3, pose);
    motion_to(&edge, pose, out);
  });
  say(lane, out, 3, changed);
}

APART int64_t edge_branching(const Task *task, Layout layout, const Lane *lane,
                             const Action *action, const real *weights) {
  real seen[SCENE + MOST_PERCEPT], out[2];
  TIMED(IN_NETWORKS, {
    Edge edge = edge_frame(lane->percept, layout);
    table_scene(&edge, lane->percept, seen);
    obstacle_scene(&edge, lane->percept, layout, seen + SCENE);
    network(seen, weights, action, 2, out);
  });
  return branch(out);
}

/* A lane's action: its outcome, and whether it changed anything a later action could depend on. */
INLINE int64_t act(const Task *task, Layout layout, Lane *lane, int *changed) {
  const Program *program = task->program;
  const Action *action = program->actions + program->kind[lane->node];
  const real *weights = program->parameters + lane->node * program->width;
  *changed = 0;
  switch (action->kind) {
  case MOVE_BASE:
    *changed = lane->has_message && !(lane->state[1] > 0) && move(task, layout, lane);
    return !*changed;
  case GRASP:
    if (lane->state[2] == UNKNOWN) {
      lane->state[2] = chance(task, layout, lane->percept);
      *changed = 1;
    }
    return lane->state[2] <= (real)0.5;
  case CONTINUOUS:
    continuous(task, lane, action, weights, changed);
    return 0;
  case EDGE:
    edge_network(task, layout, lane, action, weights, changed);
    return 0;
  case BRANCHING:
    return branching(task, lane, action, weights);
  case EDGE_BRANCHING:
    return edge_branching(task, layout, lane, action, weights);
  default: /* DETECT: Γ predicts what would be perceived */
    return 0;
  }
}

/* Into the sub-skills that a lane's node stands for, as deep as it takes (`frames.enter`). */
INLINE void enter(const Program *program, Lane *lane) {
  while (program->kind[lane->node] >= program->primitives) {
    int64_t skill = program->kind[lane->node] - program->primitives;
    lane->level++;
    lane->caller[lane->level] = lane->node;
    lane->left[lane->level] = program->limit[skill];
    lane->node = program->entry[skill];
  }
}

INLINE int has_been(const Lane *lane, int64_t node) {
  int found = 0;
  for (int64_t i = 0; i < lane->places; i++) found |= lane->been[i] == node;
  return found;
}

/* `frames.follow`: how the lane ended, 0 if it goes on; `skipped` transitions need not be made. */
INLINE int64_t follow(const Program *program, Lane *lane, int64_t outcome, int changed,
                      int64_t *skipped) {
  int64_t level = lane->level, head = program->heads[lane->node * program->outcomes + outcome];
  int64_t remain = lane->left[level] - 1;
  *skipped = !changed && has_been(lane, head) ? remain : 0;
  remain -= *skipped;
  if (head >= 0 && remain <= 0) head = TIMEOUT;
  while (head < 0 && level > 0) {
    lane->left[level] = remain;
    /* A sub-skill's first outcome is success, its second failure; a timeout is a failure. */
    head = program->heads[lane->caller[level] * program->outcomes + (head != SUCCESS)];
    remain = lane->left[--level] - 1;
    if (head >= 0 && remain <= 0) head = TIMEOUT;
  }
  lane->left[level] = remain;
  int64_t next = head < 0 ? 0 : head;
  int same = !changed && level == lane->level && program->kind[next] < program->primitives;
  if (!same) lane->places = 0;
  if (lane->places < MOST_BEEN) lane->been[lane->places++] = next;
  lane->node = next;
  lane->level = level;
  if (head < 0) return head;
  enter(program, lane);
  return 0;
}

/* A lane from its start to its end: `SUCCESS`, FAILURE, `TIMEOUT`, or 0 out of steps. */
static int64_t run_lane(const Task *task, Layout layout, int64_t graph, int64_t scenario, Lane *lane) {
  const Models *m = task->models;
  memcpy(lane->percept, m->percepts + scenario * layout.size, (size_t)layout.size * sizeof(real));
  memcpy(lane->state, m->state + scenario * 3, sizeof lane->state);
  memset(lane->message, 0, sizeof lane->message);
  lane->has_message = 0;
  lane->step = lane->level = lane->places = 0;
  lane->scenario = scenario;
  lane->node = task->program->start[graph];
  lane->left[0] = task->max_transitions;
  enter(task->program, lane);
  int64_t end = 0, skipped;
  do {
    int changed;
    int64_t outcome = act(task, layout, lane, &changed);
    end = follow(task->program, lane, outcome, changed, &skipped);
    lane->step += 1 + skipped;
    if (lane->step >= task->max_steps) {
      if (skipped) end = TIMEOUT;
      lane->step = task->max_steps;
      break;
    }
  } while (!end);
  return end;
}

static void run_graphs(void *what, int64_t begin, int64_t end) {
  const Task *task = what;
  Layout layout = layout_of(task->models->size);
  size_t wide = (size_t)layout.size * sizeof(real);
  Lane lane;
  for (int64_t row = begin * task->count; row < end * task->count; row++) {
    int64_t scenario = task->scenarios[row % task->count];
    task->status[row] = run_lane(task, layout, row / task->count, scenario, &lane);
    task->transitions[row] = lane.step;
    memcpy(task->percept + row * layout.size, lane.percept, wide);
    memcpy(task->state + row * 3, lane.state, sizeof lane.state);
  }
}

int rollouts(Task *task, int64_t threads) {
  in_parallel(run_graphs, task, task->graphs, PIECE, task->ticks ? 1 : (int)threads);
  return 0;
}

/* Eq. 3 for graphs whose nodes lie `nodes` after `nodes` in the table; of `task` only what there is
   to do is read, and its scenarios are those of W, `keep` of them, and then those of M. */
typedef struct {
  Task task;
  int64_t nodes, keep;
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

static void evaluate_graph(const Evaluation *e, Layout layout, int64_t graph) {
  const Task *task = &e->task;
  const Program *program = task->program;
  Lane lane;
  int64_t first = graph * e->nodes * program->width, done = 0, lost = 0;
  int finite = all_finite(program->parameters + first, e->nodes * program->width);
  real *score = e->score + graph * task->count;
  unsigned char *succeeded = e->succeeded + graph * task->count;
  for (int64_t i = 0; i < task->count && !(lost && i >= e->keep); i++) {
    int64_t scenario = task->scenarios[i];
    int success = run_lane(task, layout, graph, scenario, &lane) == SUCCESS;
    real c = lane.state[2];
    if (c == UNKNOWN) c = chance(task, layout, lane.percept);
    int numbers = isfinite(c) && all_finite(lane.percept, layout.size);
    finite &= numbers;
    c = numbers ? (c < 0 ? 0 : c > 1 ? 1 : c) : 0;
    score[scenario] = success ? c : c / 2;
    succeeded[scenario] = (unsigned char)success;
    lost |= i < e->keep && !success;
    done += lane.step;
  }
  if (lost) memset(score, 0, (size_t)task->count * sizeof(real));
  e->finite[graph] = (unsigned char)finite;
  e->transitions[graph] = done;
}

static void evaluate_graphs(void *what, int64_t begin, int64_t end) {
  const Evaluation *e = what;
  Layout layout = layout_of(e->task.models->size);
  for (int64_t graph = begin; graph < end; graph++) evaluate_graph(e, layout, graph);
}

/* The clock that `ticks` are of. */
int clock_now(int64_t *ticks) {
  *ticks = now();
  return 0;
}

int evaluations(Evaluation *e, int64_t threads) {
  in_parallel(evaluate_graphs, e, e->task.graphs, PIECE, e->task.ticks ? 1 : (int)threads);
  return 0;
}
