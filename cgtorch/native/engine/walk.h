/* Where a lane goes from a node: cgtorch.simulation.call_stack, for one lane at a time. */
#pragma once
#include "kinds.h"
#include "waiting.h"

#define NODES_SEEN 64 /* that `visited` can tell apart */

INLINE int64_t kinds_of(const Waiting *w) { return w->program->count; }

INLINE uint64_t seen_bit(int32_t place) { return (uint64_t)1 << (place & (NODES_SEEN - 1)); }

static void enter_skills(const Waiting *w, int64_t i) {
  const Program *p = w->program;
  int32_t own = (int32_t)(w->graphs * p->nodes), skill;
  while ((skill = w->kinds[w->node[i]] - (int32_t)p->count) >= 0) {
    int64_t at = i * p->depth + w->level[i];
    w->outer[at] = w->left[i], w->outer_first[at] = w->first[i];
    w->level[i]++;
    w->caller[at + 1] = w->node[i];
    w->left[i] = (int32_t)p->limit[skill];
    w->node[i] = w->first[i] = own + (int32_t)p->entry[skill];
    w->first[i] = own + (int32_t)p->began[skill];
    w->visited[i] = 0;
  }
}

/* Out of the sub-skills that end with `head`, and into those where it goes on: how the lane ended, 0 if
   it goes on. */
static int32_t leave_skills(const Waiting *w, int64_t i, int32_t head) {
  const Program *p = w->program;
  while (head < 0 && w->level[i] > 0) {
    /* A sub-skill's first outcome is success, its second failure; a timeout is a failure. */
    int64_t at = i * p->depth + w->level[i]--;
    head = w->heads[w->caller[at] * p->outcomes + (head != SUCCESS)];
    w->left[i] = w->outer[at - 1] - 1, w->first[i] = w->outer_first[at - 1];
    if (head >= 0 && w->left[i] <= 0) head = TIMEOUT;
  }
  if (head < 0) return head;
  w->visited[i] = 0;
  w->node[i] = head;
  enter_skills(w, i);
  return 0;
}

/* `call_stack.advance`; whether the lane goes on, else its status is set. `changed`: whether anything
   has on which a later action could depend. `over` as in Waiting. */
INLINE int walk(const Waiting *w, int64_t i, int64_t outcome, int changed, int state_changed,
                int over) {
  const Program *p = w->program;
  int32_t node = w->node[i], head = w->heads[node * p->outcomes + outcome];
  int32_t left = w->left[i] - 1, skipped = 0, end = head < 0 ? head : 0, first = w->first[i];
  int enters = 0;
  if (head >= 0) { /* back where it was with nothing changed, only the limit of transitions ends it */
    uint64_t bit = seen_bit(head - first);
    enters = w->kinds[head] >= p->count;
    int same = !changed & !enters & ((head - first) / NODES_SEEN == (node - first) / NODES_SEEN);
    if (same & ((w->visited[i] & bit) != 0)) skipped = left, left = 0;
    end = left <= 0 ? TIMEOUT : 0;
    w->visited[i] = (same ? w->visited[i] : 0) | bit;
    w->node[i] = head;
  }
  w->left[i] = left;
  if (p->depth > 1) {
    if (end && w->level[i] > 0) end = leave_skills(w, i, end);
    else if (!end && enters) enter_skills(w, i);
  }
  int64_t step = w->step[i] + 1 + skipped;
  int last = step >= w->max_steps;
  if (last & (skipped > 0)) end = TIMEOUT;
  if (w->most_idle) {
    w->idle[i] = state_changed ? 0 : w->idle[i] + 1;
    if (!end && w->idle[i] > w->most_idle) end = TIMEOUT;
  }
  if (over) end = over == 1 ? SUCCESS : FAILURE;
  w->step[i] = last ? w->max_steps : step;
  if (!(last | (end != 0))) return 1;
  w->status[i] = end;
  return 0;
}

/* The lane is where its next action is: into the queue of those that wait for it. */
INLINE void wait_for(const Waiting *w, int64_t i, int64_t begin, int64_t lanes, int64_t *sizes,
                     int64_t *waiting) {
  int32_t kind = w->kinds[w->node[i]];
  w->waits[i] = kind;
  if (w->program->primitives[kind].kind == IN_PYTHON) waiting[kind]++;
  else w->queue[kind * lanes + begin + sizes[kind]++] = (int32_t)i;
}
