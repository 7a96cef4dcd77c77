/* The actions of section VI, for the lanes of a vector that are at nodes of one kind, and their next nodes
   (cgtorch.simulation.torch_engine). */
#pragma once
#include "lanes.h"
#include "networks.h"

/* The result of an action: the lanes with its second outcome, and those where it changed anything on which a
   later action could depend. */
typedef struct {
  vwhole second, changed;
} Done;

#ifdef __cplusplus
#define PART(again, part, what) what
#else
/* Repeats a part if asked to; the results are the same. */
#define PART(again, part, what)                              \
  for (int64_t left = (again) ? 1 + (again)[part] : 1; left > 0; left--) { \
    what;                                                    \
    __asm__ volatile("" ::: "memory"); /* or it would be done once */      \
  }
#endif

/* `ModelEnvironment.step` without the errors of Γ, which `add_errors` adds. */
INLINE vwhole move(const ModelEnvironment *m, const int64_t *again, Layout layout, Lanes *lanes,
                   vwhole here) {
  vec u[MOST_MESSAGE], after[MOST_PERCEPT], novelty;
  vwhole ready = here & lanes->has_message & ~(lanes->lost > 0), moves = ready;
  for (int64_t i = 0; i < m->controls; i++) u[i] = select_vec(ready, lanes->message[i], vec_of(0));
  if (bits_of(ready))
    PART(again, IN_POSSIBLE, moves = possible(m->models, layout, lanes->percept, u, ready));
  uint32_t bits = bits_of(moves);
  if (any_of(bits)) {
    PART(again, IN_GAMMA, next_percept(m->models, layout, lanes->percept, u, bits, after, &novelty));
    for (int i = 0; i < layout.size; i++)
      lanes->percept[i] = select_vec(moves, after[i], lanes->percept[i]);
    vwhole lost = moves & (novelty > m->most_novel);
    lanes->moves = select_vec(moves, lanes->moves + 1, lanes->moves);
    lanes->lost = select_vec(lost, vec_of(1), lanes->lost);
    lanes->chance = select_vec(moves, select_vec(lost, vec_of(0), vec_of(UNKNOWN)), lanes->chance);
  }
  return moves;
}

/* Adds the errors of Γ to the lanes `here` that have just moved; a lane's number of moves selects its errors.
   */
INLINE void add_errors(const ModelEnvironment *m, const vec *errors, Lanes *lanes, vwhole here) {
  for (uint32_t bits = bits_of(here); bits; bits = bits_of(here)) {
    real moves = lanes->moves[first_of(bits)];
    const vec *error = errors + (whole)(moves - 1) % (whole)m->error_draws * m->size;
    vwhole same = here & (lanes->moves == moves);
    for (int i = 0; i < m->size; i++)
      lanes->percept[i] = select_vec(same, lanes->percept[i] + error[i], lanes->percept[i]);
    here &= ~same;
  }
}

/* Evaluates C where it is unknown since the last move; returns these lanes. */
INLINE vwhole ask_chance(const ModelEnvironment *m, const int64_t *again, Layout layout,
                         Lanes *lanes, vwhole here) {
  vwhole unknown = here & (lanes->chance == UNKNOWN);
  vec chance;
  if (any_of(bits_of(unknown))) {
    PART(again, IN_C, chance = chance_of(m->models, layout, lanes->percept, bits_of(unknown)));
    lanes->chance = select_vec(unknown, chance, lanes->chance);
  }
  return unknown;
}

#define LEAST_LEFT (real)0.2 /* of a value, however many transitions it took */

/* The value of ended lanes by eq. 3, less the cost of transitions, 0 where anything is not finite. */
INLINE vec worth(Layout layout, const Lanes *lanes, real cost, vwhole *finite) {
  *finite = finite_vec(lanes->chance);
  for (int i = 0; i < layout.size; i++) *finite &= finite_vec(lanes->percept[i]);
  vec c = vec_max(vec_of(0), vec_min(vec_of(1), lanes->chance));
  vec left = vec_max(1 - cost * as_numbers(lanes->step), vec_of(LEAST_LEFT));
  return select_vec(*finite, select_vec(lanes->status == SUCCESS, c, c / 2) * left, vec_of(0));
}

INLINE Done say(Lanes *lanes, const vec *said, int64_t count, vwhole here) {
  vwhole other = ~lanes->has_message;
  UP_TO(i, count, MOST_MESSAGE) {
    other |= lanes->message[i] != said[i];
    lanes->message[i] = select_vec(here, said[i], lanes->message[i]);
  }
  lanes->has_message |= here;
  return MAKE(Done){every(0), here & other};
}

/* The outputs of networks for percepts of lanes `here`, with common weights or, in columns, those of each. */
INLINE void answer_with(const Action *a, const real *weights, const vec *columns, const void *models,
                        Layout layout, const vec *percept, vwhole here, vec *out) {
  vec seen[MOST_SEEN];
  View view;
  const vec *x = looked_at(a->kind, layout, percept, seen, &view);
  network(x, weights, columns, INPUTS_OF(a), HIDDEN_OF(a), (int)a->outputs, out);
  said(models, a->kind, layout, percept, &view, here, out);
}
APART void answer(const Action *a, const real *weights, const void *models, Layout layout,
                  const vec *percept, vwhole here, vec *out) {
  answer_with(a, weights, NULL, models, layout, percept, here, out);
}
INLINE Done apply_output(const Action *a, const vec *out, Lanes *lanes, vwhole here) {
  if (a->kind == BRANCHING || a->kind == DOMAIN_BRANCHING) return MAKE(Done){branch(out), every(0)};
  return say(lanes, out, a->outputs, here);
}

#define PAGE (8 * (int)sizeof(whole)) /* nodes that `visited` can tell apart */

/* Places count from the graph's first node; those of sub-skills are before it. Loops that span two pages are
   executed; hardly any graph has more nodes than a page. */
INLINE int64_t page_of(int64_t place) { return place >> (sizeof(whole) == 4 ? 5 : 6); }
INLINE vwhole bit_of(int64_t place) { return every((whole)((uint64_t)1 << (place & (PAGE - 1)))); }

/* Enters the sub-skills of a lane's node, through all levels (`call_stack.enter`). */
APART void enter(const Program *program, GraphRows graph, Lanes *lanes, int i) {
  for (;;) {
    int64_t skill = kind_of(program, graph, lanes->node[i]) - program->count;
    if (skill < 0) return;
    lanes->outer[lanes->level[i]][i] = lanes->left[i];
    whole level = ++lanes->level[i];
    lanes->caller[level][i] = lanes->node[i];
    lanes->left[i] = (whole)program->limit[skill];
    lanes->node[i] = (whole)program->entry[skill];
    lanes->visited[i] = 0;
  }
}

/* Leaves the sub-skills that end with `head`, an end, and enters the next ones; returns how the lane ended,
   or 0. */
APART whole leave(const Program *program, GraphRows graph, Lanes *lanes, int i, int64_t head) {
  while (head < 0 && lanes->level[i] > 0) {
    /* A sub-skill's first outcome is success, its second failure; a timeout is a failure. */
    whole level = lanes->level[i]--;
    head = head_of(program, graph, lanes->caller[level][i], head != SUCCESS);
    lanes->left[i] = lanes->outer[level - 1][i] - 1;
    if (head >= 0 && lanes->left[i] <= 0) head = TIMEOUT;
  }
  if (head < 0) return (whole)head;
  lanes->visited[i] = 0;
  lanes->node[i] = (whole)head;
  enter(program, graph, lanes, i);
  return 0;
}

/* `call_stack.advance` for lanes `here`, all at `node` with the same outcome; returns those that have ended,
   and sets their status. */
INLINE vwhole advance(const Task *task, GraphRows graph, Lanes *lanes, int64_t node, int64_t outcome,
                     vwhole here, vwhole changed) {
  const Program *program = task->program;
  int64_t head = head_of(program, graph, node, outcome), first = program->rows;
  int enters = head >= 0 && kind_of(program, graph, head) >= program->count;
  vwhole left = lanes->left - 1, skipped = every(0), end = every((whole)head);
  if (head >= 0) { /* in an unchanged state again, only the limit of transitions ends the lane */
    vwhole bit = bit_of(head - first), same = here & ~changed;
    if (enters || page_of(head - first) != page_of(node - first)) same = every(0);
    skipped = left & same & ((lanes->visited & bit) != 0);
    left -= skipped;
    end = (left <= 0) & TIMEOUT;
    lanes->visited = select_whole(here, (lanes->visited & same) | bit, lanes->visited);
    lanes->node = select_whole(here, every((whole)head), lanes->node);
  }
  lanes->left = select_whole(here, left, lanes->left);
  vwhole apart = here & select_whole(end != 0, lanes->level > 0, every(-enters));
  for (uint32_t bits = program->depth > 1 ? bits_of(apart) : 0; bits; bits &= bits - 1) {
    int i = first_of(bits);
    if (end[i]) end[i] = leave(program, graph, lanes, i, end[i]);
    else enter(program, graph, lanes, i);
  }
  vwhole step = lanes->step + 1 + skipped, most = every((whole)task->max_steps), over = step >= most;
  end = select_whole(over & (skipped > 0), every(TIMEOUT), end);
  lanes->step = select_whole(here, select_whole(over, most, step), lanes->step);
  lanes->executed -= here;
  lanes->status = select_whole(here, end, lanes->status);
  return here & (over | (end != 0));
}
