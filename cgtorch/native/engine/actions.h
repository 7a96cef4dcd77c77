/* The actions of section VI, for the lanes of a vector that are at nodes of one kind. */
#pragma once
#include "kinds.h"
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
