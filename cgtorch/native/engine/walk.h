/* Where a lane goes from a node: cgtorch.simulation.call_stack, for one lane at a time. */
#pragma once
#include "kinds.h"
#include "waiting.h"

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

/* Out of the sub-skills that end with `head`, and into those where it goes on: how the lane ended, 0 if
   it goes on. */
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

/* What the walks of many lanes have in common. */
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

/* `call_stack.advance`: the kind of the node where the lane goes, or -1 where it ends, which is
   written down. `changed`: whether anything has on which a later action could depend. `over` as in Waiting. */
INLINE int32_t walk(const Walk *v, int64_t i, int64_t outcome, int changed, int state_changed,
                    int over) {
  Place *at = v->places + i;
  Successor successor = v->successors[at->node * v->outcomes + outcome];
  int32_t left = at->left - 1, skipped = 0, end = successor.head < 0 ? successor.head : 0, step = at->step + 1;
  int enters = 0;
  if (successor.head >= 0) { /* back where it was with nothing changed, only the limit of transitions ends it */
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
