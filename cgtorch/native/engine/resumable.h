/* Lanes that run until they need Python. Include it where the models are defined (models.h). */
#pragma once
#include "actions.h"
#include "library.h"
#include "waiting.h"

/* Lanes that continue together, from a share's queue; the last vector is padded with the first one. */
typedef struct {
  int64_t lane[WIDTH];
  int count;
  vwhole here;
  const real *rows[WIDTH];
} Together;

INLINE void rows_of(Together *t, const real *tensor, int64_t size) {
  for (int i = 0; i < WIDTH; i++) t->rows[i] = tensor + t->lane[i] * size;
}

INLINE const real *weights_of(const Waiting *w, int64_t node) {
  const Program *p = w->program;
  int64_t own = w->graphs * p->nodes;
  return node < own ? p->parameters + node * p->each : p->learned + (node - own) * p->width;
}

INLINE int reads_all(int64_t kind) { return kind == DOMAIN_NN || kind == DOMAIN_OTHER_NN || kind == DOMAIN_BRANCHING; }

/* `count` weights: those of the node of all lanes or, in columns, each lane's own (returns NULL). */
INLINE const real *weights_for(const Waiting *w, Together *t, int count, vec *columns) {
  int32_t node = w->places[t->lane[0]].node, differ = 0;
  for (int i = 1; i < WIDTH; i++) differ |= w->places[t->lane[i]].node ^ node;
  if (!differ) return weights_of(w, node);
  for (int i = 0; i < WIDTH; i++) t->rows[i] = weights_of(w, w->places[t->lane[i]].node);
  into_columns_of(t->rows, count, columns);
  return NULL;
}

/* Writes part i of some vectors as a row; returns whether anything changed. */
INLINE int write_row(const vec *from, int i, real *to, int64_t count) {
  int other = 0;
  for (int64_t j = 0; j < count; j++) {
    other |= to[j] != from[j][i];
    to[j] = from[j][i];
  }
  return other;
}
INLINE int tell(const Waiting *w, int64_t lane, const vec *out, int i, int64_t count) {
  int other = !w->has_message[lane];
  w->has_message[lane] = 1;
  return other | write_row(out, i, w->message + lane * w->message_size, count);
}

INLINE Done network_of(const Waiting *w, Layout layout, const Action *a, Together *t) {
  vec percept[MOST_READ], out[MOST_SENT], columns[MOST_COLUMNS];
  rows_of(t, w->percept, w->percept_size);
  into_columns_of(t->rows, (int)(reads_all(a->kind) ? w->percept_size : a->inputs), percept);
  const real *weights = weights_for(w, t, num_weights(a), columns);
  const void *models = w->environment ? w->environment->models : NULL;
  if (weights) answer(a, weights, models, layout, percept, t->here, out);
  else answer_with(a, NULL, columns, models, layout, percept, t->here, out);
  if (a->kind == BRANCHING || a->kind == DOMAIN_BRANCHING) return MAKE(Done){branch(out), every(0)};
  vwhole changed = every(0);
  for (int i = 0; i < t->count; i++) changed[i] = -tell(w, t->lane[i], out, i, a->outputs);
  return MAKE(Done){every(0), changed};
}

/* Percepts, followed by the first `count` numbers of the action's part of the memory. */
INLINE real *read_memory(const Waiting *w, const Action *a, Together *t, int count, vec *x) {
  real *memory = w->common + w->memory[2 * (a - w->program->primitives)];
  rows_of(t, w->percept, w->percept_size);
  into_columns_of(t->rows, (int)a->inputs, x);
  rows_of(t, memory, w->memory_size);
  into_columns_of(t->rows, count, x + a->inputs);
  return memory;
}
/* Lanes get the networks' outputs as messages and store `state`; returns where either changed. */
INLINE Done remembered(const Waiting *w, Together *t, const vec *out, int outputs, const vec *state,
                       int count, real *memory) {
  vwhole changed = every(0);
  for (int i = 0; i < t->count; i++) {
    int other = tell(w, t->lane[i], out, i, outputs);
    changed[i] = -(other | write_row(state, i, memory + t->lane[i] * w->memory_size, count));
  }
  return MAKE(Done){every(0), changed};
}

INLINE Done recurrent_of(const Waiting *w, const Action *a, Together *t) {
  vec x[MOST_READ + MOST_HIDDEN], state[MOST_HIDDEN], out[MOST_SENT], columns[MOST_COLUMNS];
  int inputs = (int)a->inputs, hidden = (int)a->hidden, outputs = (int)a->outputs;
  real *memory = read_memory(w, a, t, hidden, x);
  const real *weights = weights_for(w, t, num_weights(a), columns);
  if (weights) recurrent(x, weights, NULL, inputs, hidden, outputs, state, out);
  else recurrent(x, NULL, columns, inputs, hidden, outputs, state, out);
  return remembered(w, t, out, outputs, state, hidden, memory);
}

INLINE Done delay_of(const Waiting *w, const Action *a, Together *t) {
  vec x[MOST_DELAYED], out[MOST_SENT], columns[MOST_COLUMNS];
  int inputs = (int)a->inputs, delays = (int)a->delays, outputs = (int)a->outputs;
  real *memory = read_memory(w, a, t, inputs * delays, x);
  const real *weights = weights_for(w, t, num_weights(a), columns);
  if (weights) delayed(x, weights, NULL, inputs, delays, outputs, out);
  else delayed(x, NULL, columns, inputs, delays, outputs, out);
  return remembered(w, t, out, outputs, x, inputs * delays, memory);
}

INLINE real *state_of(const Waiting *w, int64_t lane) {
  return (real *)(w->state + lane * w->state_bytes);
}

INLINE void read_percept(const Waiting *w, Together *t, Lanes *lanes) {
  rows_of(t, w->percept, w->percept_size);
  into_columns_of(t->rows, (int)w->percept_size, lanes->percept);
}
INLINE void read_state(const Waiting *w, Together *t, Lanes *lanes) {
  vec state[3];
  for (int i = 0; i < WIDTH; i++) t->rows[i] = state_of(w, t->lane[i]);
  into_columns_of(t->rows, 3, state);
  lanes->moves = state[0], lanes->lost = state[1], lanes->chance = state[2];
}

/* `ModelEnvironment.step` */
APART Done step_of(const Waiting *w, Layout layout, Together *t) {
  const ModelEnvironment *m = w->environment;
  Lanes lanes;
  read_percept(w, t, &lanes);
  read_state(w, t, &lanes);
  rows_of(t, w->message, w->message_size);
  into_columns_of(t->rows, (int)m->controls, lanes.message);
  for (int i = 0; i < WIDTH; i++) lanes.has_message[i] = -(w->has_message[t->lane[i]] != 0);
  vwhole moved = move(m, NULL, layout, &lanes, t->here);
  for (uint32_t bits = bits_of(moved); bits; bits &= bits - 1) {
    int i = first_of(bits);
    real *percept = w->percept + t->lane[i] * w->percept_size, *state = state_of(w, t->lane[i]);
    int64_t turn = (int64_t)state[0] % m->error_draws, scenario = w->first_scenario[t->lane[i] % w->firsts];
    const real *error = m->errors ? m->errors + (scenario * m->error_draws + turn) * m->size : NULL;
    for (int j = 0; j < layout.size; j++)
      percept[j] = error ? lanes.percept[j][i] + error[j] : lanes.percept[j][i];
    state[0] = lanes.moves[i], state[1] = lanes.lost[i], state[2] = lanes.chance[i];
  }
  return MAKE(Done){~moved, moved};
}

APART Done test_of(const Waiting *w, Layout layout, Together *t) {
  Lanes lanes;
  read_state(w, t, &lanes);
  vwhole unknown = t->here & (lanes.chance == UNKNOWN);
  if (!bits_of(unknown)) return MAKE(Done){lanes.chance <= (real)0.5, unknown};
  read_percept(w, t, &lanes);
  vwhole asked = ask_chance(w->environment, NULL, layout, &lanes, t->here);
  for (uint32_t bits = bits_of(asked); bits; bits &= bits - 1) {
    int i = first_of(bits);
    state_of(w, t->lane[i])[2] = lanes.chance[i];
  }
  return MAKE(Done){lanes.chance <= (real)0.5, asked};
}

INLINE Done together(const Waiting *w, Layout layout, const Action *a, Together *t) {
  switch (a->kind) {
  case STEP: return step_of(w, layout, t);
  case TEST: return test_of(w, layout, t);
  case PERCEIVE: return MAKE(Done){every(0), every(0)};
  case RECURRENT: return recurrent_of(w, a, t);
  case DELAY: return delay_of(w, a, t);
  default: return network_of(w, layout, a, t);
  }
}

/* How many of the first `count` lanes of a queue run together: all or, where a network has too many weights to
   be laid out in columns for each lane, those at the node of the first one. */
INLINE int64_t at_once(const Waiting *w, const Action *a, const int32_t *queue, int64_t count) {
  if (num_weights(a) <= MOST_COLUMNS) return count;
  int32_t node = w->places[queue[0]].node;
  int64_t same = 1;
  while (same < count && w->places[queue[same]].node == node) same++;
  return same;
}

/* Runs all lanes that wait for an action of compiled code. Lanes that then wait for something are added to
   the end of its queue, or to a place that has been read. */
static void run_queue(const Waiting *w, Layout layout, const Action *a, const int32_t *queue,
                      int64_t total, int32_t **ends) {
  Walk v = walk_of(w);
  for (int64_t from = 0, count; from < total; from += count) {
    count = at_once(w, a, queue + from, total - from < WIDTH ? total - from : WIDTH);
    Together t = {.count = (int)count};
    for (int i = 0; i < WIDTH; i++) t.lane[i] = queue[from + (i < t.count ? i : 0)];
    for (int i = 0; i < WIDTH; i++) t.here[i] = -(i < t.count);
    Done done = together(w, layout, a, &t);
    uint32_t second = bits_of(done.second), changed = bits_of(done.changed);
    for (int i = 0; i < t.count; i++) {
      int32_t kind = walk(&v, t.lane[i], second >> i & 1, changed >> i & 1, 0, 0);
      if (kind >= 0) *ends[kind]++ = (int32_t)t.lane[i];
    }
  }
}

/* Reads Python's result in row k. Returns bit 1 if anything changed, and bit 2 if the state did. */
INLINE int take_back(const Waiting *w, int64_t k, int64_t i) {
  int changed = 0;
  if (w->new_percept)
    changed |= copied_row(w->new_percept + k * w->percept_size, w->percept + i * w->percept_size,
                          w->percept_size);
  if (w->new_message)
    changed |= copied_row(w->new_message + k * w->message_size, w->message + i * w->message_size,
                          w->message_size);
  if (w->new_memory) {
    const int64_t *part = w->memory + 2 * w->kind;
    changed |= copied_row(w->new_memory + k * part[1], w->common + i * w->memory_size + part[0],
                          part[1]);
  }
  if (w->new_has) changed |= w->new_has[k] != w->has_message[i], w->has_message[i] = w->new_has[k];
  if (!w->new_state) return changed;
  const unsigned char *from = w->new_state + k * w->state_bytes;
  unsigned char *to = w->state + i * w->state_bytes;
  int other;
  if (w->state_is_real)
    other = copied_row((const real *)from, (real *)to, w->state_bytes / (int64_t)sizeof(real));
  else if ((other = memcmp(from, to, (size_t)w->state_bytes) != 0))
    memcpy(to, from, (size_t)w->state_bytes);
  return changed | (other ? 3 : 0);
}

/* The outcome of row k, -1 if it does not exist. */
INLINE int64_t outcome_of(const Waiting *w, int64_t k) {
  if (w->done) return !w->done[k];
  if (w->chance) return w->chance[k] <= (real)0.5;
  if (!w->outcome) return 0;
  int64_t outcome = w->outcome[k];
  return outcome < 0 || outcome >= w->program->outcomes ? -1 : outcome;
}

/* Continues the lanes of a share for which Python has finished. */
static void answered(Waiting *w, int64_t share, const int32_t *queue, int64_t total, int32_t **ends) {
  int always = !w->deterministic[w->kind];
  Walk v = walk_of(w);
  for (int64_t at = 0; at < total; at++) {
    int64_t i = w->everyone ? share * SHARE + at : queue[at], k = w->offset[share] + at;
    int64_t outcome = outcome_of(w, k);
    if (outcome < 0) {
      __atomic_store_n(&w->wrong_outcome, w->outcome[k], __ATOMIC_RELAXED);
      __atomic_fetch_add(&w->num_wrong, 1, __ATOMIC_RELAXED);
      outcome = 0;
    }
    int changed = take_back(w, k, i), over = w->over ? w->over[k] : 0;
    int32_t kind = walk(&v, i, outcome, (changed & 1) | always, changed >> 1, over);
    if (kind >= 0) *ends[kind]++ = (int32_t)i;
  }
}

static void run_share(void *what, int64_t begin, int64_t end) {
  Waiting *w = what;
  int64_t kinds = w->program->count, share = begin / SHARE, lanes = w->graphs * w->count;
  int64_t *waiting = w->waiting + share * kinds, executed = 0;
  int32_t *ends[kinds + 1];
  Layout layout = layout_of(w->percept_size);
  for (int64_t k = 0; k < kinds; k++) ends[k] = w->queue + k * lanes + begin + waiting[k];
  if (w->kind >= 0) {
    executed = waiting[w->kind];
    ends[w->kind] -= executed;
    answered(w, share, ends[w->kind], executed, ends);
  } else {
    for (int64_t i = begin; i < end; i++) *ends[w->kinds[w->places[i].node]]++ = (int32_t)i;
  }
  for (;;) {
    int64_t most = 0, kind = -1;
    for (int64_t k = 0; k < kinds; k++) {
      int64_t size = ends[k] - (w->queue + k * lanes + begin);
      waiting[k] = size;
      if (size > most && w->program->primitives[k].kind != IN_PYTHON) most = size, kind = k;
    }
    if (kind < 0) break;
    ends[kind] -= most;
    executed += most;
    run_queue(w, layout, w->program->primitives + kind, ends[kind], most, ends);
  }
  w->executed[share] += executed;
}
