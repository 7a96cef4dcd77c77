/* Algorithm 3 in Γ and C: every graph on every scenario, one lane at a time from start to end
   (cgtorch.simulation.compiled). */
#include "models.h"
#include "parallel.h"

#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define MOST_HIDDEN 64
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
  int64_t scenario, step, node, level, anchor, since;
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
INLINE void network(const real *x, const real *w, const Action *a, real *out) {
  real hidden[MOST_HIDDEN];
  const real *b1 = w + a->hidden * a->inputs, *w2 = b1 + a->hidden, *b2 = w2 + a->outputs * a->hidden;
  for (int64_t i = 0; i < a->hidden; i++) {
    real total = 0;
    for (int64_t j = 0; j < a->inputs; j++) total += w[i * a->inputs + j] * x[j];
    hidden[i] = sigmoid(total + b1[i]);
  }
  for (int64_t i = 0; i < a->outputs; i++) {
    real total = 0;
    for (int64_t j = 0; j < a->hidden; j++) total += w2[i * a->hidden + j] * hidden[j];
    out[i] = total + b2[i];
  }
}

INLINE void say(Lane *lane, const real *said, int64_t count, int *changed) {
  *changed = !lane->has_message;
  for (int64_t i = 0; i < count; i++) *changed |= lane->message[i] != said[i];
  memcpy(lane->message, said, (size_t)count * sizeof(real));
  lane->has_message = 1;
}

/* `ModelEnvironment.step`: 1 where the base has moved. */
static int move(const Task *task, Layout layout, Lane *lane) {
  const Models *m = task->models;
  const real *u = lane->message;
  int possible = 0;
  if (!lane->has_message || lane->state[1] > 0) return 0;
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

/* A lane's action: its outcome, and whether it changed anything a later action could depend on. */
static int64_t act(const Task *task, Layout layout, Lane *lane, int *changed) {
  const Program *program = task->program;
  const Action *action = program->actions + program->kind[lane->node];
  const real *weights = program->parameters + lane->node * program->width;
  real seen[MOST_PERCEPT * 2], out[MOST_MESSAGE];
  int64_t outcome = 0;
  *changed = 0;
  switch (action->kind) {
  case MOVE_BASE:
    *changed = move(task, layout, lane);
    outcome = !*changed;
    break;
  case GRASP:
    if (lane->state[2] == UNKNOWN) {
      TIMED(IN_C, lane->state[2] = success_row(&task->models->classifier, layout, lane->percept));
      *changed = 1;
    }
    outcome = lane->state[2] <= (real)0.5;
    break;
  case CONTINUOUS:
    TIMED(IN_NETWORKS, network(lane->percept, weights, action, out));
    say(lane, out, action->outputs, changed);
    break;
  case EDGE:
    TIMED(IN_NETWORKS, {
      Edge edge = edge_frame(lane->percept, layout);
      real pose[3];
      table_scene(&edge, lane->percept, seen);
      network(seen, weights, action, pose);
      motion_to(&edge, pose, out);
    });
    say(lane, out, 3, changed);
    break;
  case BRANCHING:
    TIMED(IN_NETWORKS, network(lane->percept, weights, action, out));
    outcome = sigmoid(out[1]) > sigmoid(out[0]);
    break;
  case EDGE_BRANCHING:
    TIMED(IN_NETWORKS, {
      Edge edge = edge_frame(lane->percept, layout);
      table_scene(&edge, lane->percept, seen);
      obstacle_scene(&edge, lane->percept, layout, seen + SCENE);
      network(seen, weights, action, out);
    });
    outcome = sigmoid(out[1]) > sigmoid(out[0]);
    break;
  default: /* DETECT: Γ predicts what would be perceived */
    break;
  }
  return outcome;
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

/* `frames.follow`: how the lane ended, 0 if it goes on; `skipped` transitions need not be made. */
INLINE int64_t follow(const Program *program, Lane *lane, int64_t outcome, int changed,
                      int64_t *skipped) {
  int64_t level = lane->level, head = program->heads[lane->node * program->outcomes + outcome];
  int64_t remain = lane->left[level] - 1;
  *skipped = !changed && head >= 0 && head == lane->anchor ? remain : 0;
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
  lane->since = same ? lane->since + 1 : 0;
  if ((lane->since & (lane->since - 1)) == 0) lane->anchor = head; /* Brent's cycle detection */
  lane->node = next;
  lane->level = level;
  if (head < 0) return head;
  enter(program, lane);
  return 0;
}

static void run_lane(const Task *task, Layout layout, int64_t graph, int64_t index) {
  const Models *m = task->models;
  Lane lane = {.scenario = task->scenarios[index], .node = task->program->start[graph], .anchor = -1};
  size_t wide = (size_t)layout.size * sizeof(real);
  memcpy(lane.percept, m->percepts + lane.scenario * layout.size, wide);
  memcpy(lane.state, m->state + lane.scenario * 3, sizeof lane.state);
  lane.left[0] = task->max_transitions;
  enter(task->program, &lane);
  int64_t end = 0, skipped;
  do {
    int changed;
    int64_t outcome = act(task, layout, &lane, &changed);
    end = follow(task->program, &lane, outcome, changed, &skipped);
    lane.step += 1 + skipped;
    if (lane.step >= task->max_steps) {
      if (skipped) end = TIMEOUT;
      break;
    }
  } while (!end);
  int64_t row = graph * task->count + index;
  memcpy(task->percept + row * layout.size, lane.percept, wide);
  memcpy(task->state + row * 3, lane.state, sizeof lane.state);
  task->status[row] = end;
  task->transitions[row] = lane.step < task->max_steps ? lane.step : task->max_steps;
}

static void run_graphs(void *what, int64_t begin, int64_t end) {
  const Task *task = what;
  Layout layout = layout_of(task->models->size);
  for (int64_t graph = begin; graph < end; graph++)
    for (int64_t i = 0; i < task->count; i++) run_lane(task, layout, graph, i);
}

int rollouts(Task *task, int64_t threads) {
  in_parallel(run_graphs, task, task->graphs, 8, task->ticks ? 1 : (int)threads);
  return 0;
}
