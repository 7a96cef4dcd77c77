/* The actions of section VI for those of a vector of lanes that are at one node. */
#pragma once
#include "tabletop/edge.h"
#include "lanes.h"

/* What an action did: the lanes with its second outcome, and those where it changed anything that a
   later action could depend on. */
typedef struct {
  vwhole second, changed;
} Done;

/* The errors of Γ in the moves that `here` have just made, which are counted later: those of each
   number of moves before for the lanes that have made so many. */
INLINE void add_errors(const Models *m, const vec *errors, Lanes *lanes, int size, vwhole here) {
  for (uint32_t bits = bits_of(here); bits; bits = bits_of(here)) {
    real moves = lanes->moves[__builtin_ctz(bits)];
    const vec *error = errors + (int64_t)moves % m->turns * size;
    vwhole same = here & (lanes->moves == moves);
    for (int i = 0; i < size; i++)
      lanes->percept[i] = select_vec(same, lanes->percept[i] + error[i], lanes->percept[i]);
    here &= ~same;
  }
}

/* `ModelEnvironment.step` */
INLINE Done move_base(const Task *task, Layout layout, const vec *errors, Lanes *lanes, vwhole here) {
  const Models *m = task->models;
  vec u[3], after[MOST_PERCEPT], novelty;
  vwhole ready = here & lanes->has_message & ~(lanes->lost > 0), moves = ready;
  for (int i = 0; i < 3; i++) u[i] = select_vec(ready, lanes->message[i], all(0));
  if (bits_of(ready))
    PART(task->again, IN_POSSIBLE,
          moves = motion_possible(lanes->percept, u, layout, &m->body, ready));
  uint32_t bits = bits_of(moves);
  if (bits) {
    PART(task->again, IN_GAMMA,
          gamma_vec(&m->gamma, layout, lanes->percept, u, bits, after, &novelty));
    for (int i = 0; i < layout.size; i++)
      lanes->percept[i] = select_vec(moves, after[i], lanes->percept[i]);
    if (m->errors) add_errors(m, errors, lanes, layout.size, moves);
    vwhole lost = moves & (novelty > m->most_novel);
    lanes->moves = select_vec(moves, lanes->moves + 1, lanes->moves);
    lanes->lost = select_vec(lost, all(1), lanes->lost);
    lanes->chance = select_vec(moves, select_vec(lost, all(0), all(UNKNOWN)), lanes->chance);
  }
  return (Done){~moves, moves};
}

/* Asks C where nobody has asked since the last move; those are what it gives. */
INLINE vwhole ask_chance(const Task *task, Layout layout, Lanes *lanes, vwhole here) {
  vwhole unknown = here & (lanes->chance == UNKNOWN);
  vec chance;
  if (bits_of(unknown)) {
    PART(task->again, IN_C, chance = success_vec(&task->models->classifier, layout,
                                                  lanes->percept, bits_of(unknown)));
    lanes->chance = select_vec(unknown, chance, lanes->chance);
  }
  return unknown;
}

INLINE Done say(Lanes *lanes, const vec *said, int64_t count, vwhole here) {
  vwhole other = ~lanes->has_message;
  for (int64_t i = 0; i < count; i++) {
    other |= lanes->message[i] != said[i];
    lanes->message[i] = select_vec(here, said[i], lanes->message[i]);
  }
  lanes->has_message |= here;
  return (Done){every(0), here & other};
}

/* ---- Networks with one hidden layer, cgtorch.actions.networks.one_hidden_layer ---- */

#define MOST_HIDDEN 64

INLINE vec weighted(const vec *x, const real *w, int count, real bias) {
  vec total = all(0);
  for (int i = 0; i < count; i++) total += w[i] * x[i];
  return total + bias;
}
INLINE void layers(const vec *x, const real *w, int inputs, int hidden, int outputs, vec *out) {
  vec at[MOST_HIDDEN];
  const real *b1 = w + hidden * inputs, *w2 = b1 + hidden, *b2 = w2 + outputs * hidden;
  for (int i = 0; i < hidden; i++) at[i] = sigmoid_vec(weighted(x, w + i * inputs, inputs, b1[i]));
  for (int i = 0; i < outputs; i++) out[i] = weighted(at, w2 + i * hidden, hidden, b2[i]);
}
INLINE void network(const vec *x, const real *w, int inputs, int hidden, int outputs, vec *out) {
  if (hidden == 3 && inputs == 7) layers(x, w, 7, 3, outputs, out);
  else if (hidden == 3 && inputs == 9) layers(x, w, 9, 3, outputs, out);
  else layers(x, w, inputs, hidden, outputs, out);
}
/* The lanes that take a branch's second way. */
INLINE vwhole branch(const vec *out) { return sigmoid_vec(out[1]) > sigmoid_vec(out[0]); }

/* What networks say, of what is seen as it is or from the edge nearest to the object. */
APART void answer(const Action *a, const real *weights, Layout layout, const vec *percept, vec *out) {
  int inputs = (int)a->inputs, hidden = (int)a->hidden;
  if (a->kind == CONTINUOUS) network(percept, weights, inputs, hidden, (int)a->outputs, out);
  else if (a->kind == BRANCHING) network(percept, weights, inputs, hidden, 2, out);
  else {
    vec seen[SCENE + MOST_PERCEPT], pose[3];
    Edge edge = edge_frame(percept, layout);
    table_scene(&edge, percept, seen);
    if (a->kind == EDGE) {
      network(seen, weights, inputs, hidden, 3, pose);
      motion_to(&edge, pose, out);
    } else {
      obstacle_scene(&edge, percept, layout, seen + SCENE);
      network(seen, weights, inputs, hidden, 2, out);
    }
  }
}

/* The action of the node that lanes `here` are at. */
INLINE Done act(const Task *task, GraphRows graph, Layout layout, const vec *errors, Lanes *lanes,
                int64_t node, vwhole here) {
  const Program *program = task->program;
  const Action *action = program->primitives + kind_of(program, graph, node);
  vec out[MOST_MESSAGE];
  vwhole asked;
  switch (action->kind) {
  case MOVE_BASE: return move_base(task, layout, errors, lanes, here);
  case GRASP:
    asked = ask_chance(task, layout, lanes, here);
    return (Done){lanes->chance <= (real)0.5, asked};
  case DETECT: return (Done){every(0), every(0)}; /* Γ predicts what would be perceived */
  default:
    PART(task->again, IN_NETWORKS, answer(action, parameters_of_node(program, graph, node), layout,
                                           lanes->percept, out));
    if (action->kind == BRANCHING || action->kind == EDGE_BRANCHING)
      return (Done){branch(out), every(0)};
    return say(lanes, out, action->kind == EDGE ? 3 : action->outputs, here);
  }
}
