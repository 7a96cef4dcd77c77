/* Where lanes go from a node: cgtorch.simulation.frames. */
#ifndef CGTORCH_FOLLOW_H
#define CGTORCH_FOLLOW_H
#include "lanes.h"

#define PAGE (8 * (int)sizeof(whole)) /* nodes that `been` can tell apart */

/* Places are counted from the graph's first node. In loops over two pages every transition is made;
   hardly any graph has more nodes than a page. */
INLINE int64_t page_of(int64_t place) { return place >= 0 ? place / PAGE : -1; }
INLINE vwhole bit_of(int64_t place) { return every((whole)((uint64_t)1 << (place & (PAGE - 1)))); }

/* Into the sub-skills that a lane's node stands for, as deep as it takes (`frames.enter`). */
APART void enter(const Program *program, Lanes *lanes, int i) {
  while (program->kind[lanes->node[i]] >= program->primitives) {
    int64_t skill = program->kind[lanes->node[i]] - program->primitives;
    lanes->outer[lanes->level[i]][i] = lanes->left[i];
    whole level = ++lanes->level[i];
    lanes->caller[level][i] = lanes->node[i];
    lanes->left[i] = (whole)program->limit[skill];
    lanes->node[i] = (whole)program->entry[skill];
    lanes->been[i] = 0;
  }
}

/* Out of the sub-skills that end with `head`, an end, and into those where it goes on: how the lane
   ended, 0 if it goes on. */
APART whole leave(const Program *program, Lanes *lanes, int i, int64_t head) {
  while (head < 0 && lanes->level[i] > 0) {
    /* A sub-skill's first outcome is success, its second failure; a timeout is a failure. */
    whole level = lanes->level[i]--;
    head = program->heads[lanes->caller[level][i] * program->outcomes + (head != SUCCESS)];
    lanes->left[i] = lanes->outer[level - 1][i] - 1;
    if (head >= 0 && lanes->left[i] <= 0) head = TIMEOUT;
  }
  if (head < 0) return (whole)head;
  lanes->been[i] = 0;
  lanes->node[i] = (whole)head;
  enter(program, lanes, i);
  return 0;
}

/* `frames.follow` for lanes `here`, all of them at `node` and with the same outcome; gives those that
   have ended, and sets their status. */
INLINE vwhole follow(const Task *task, Lanes *lanes, int64_t first, int64_t node, int64_t outcome,
                     vwhole here, vwhole changed) {
  const Program *program = task->program;
  int64_t head = program->heads[node * program->outcomes + outcome];
  int enters = head >= 0 && program->kind[head] >= program->primitives;
  vwhole left = lanes->left - 1, skipped = every(0), end = every((whole)head);
  if (head >= 0) { /* back where it was with nothing changed, only the limit of transitions ends it */
    vwhole bit = bit_of(head - first), same = here & ~changed;
    if (enters || page_of(head - first) != page_of(node - first)) same = every(0);
    skipped = left & same & ((lanes->been & bit) != 0);
    left -= skipped;
    end = (left <= 0) & TIMEOUT;
    lanes->been = select_whole(here, (lanes->been & same) | bit, lanes->been);
    lanes->node = select_whole(here, every((whole)head), lanes->node);
  }
  lanes->left = select_whole(here, left, lanes->left);
  vwhole apart = here & select_whole(end != 0, lanes->level > 0, every(-enters));
  for (uint32_t bits = program->depth > 1 ? bits_of(apart) : 0; bits; bits &= bits - 1) {
    int i = __builtin_ctz(bits);
    if (end[i]) end[i] = leave(program, lanes, i, end[i]);
    else enter(program, lanes, i);
  }
  vwhole step = lanes->step + 1 + skipped, most = every((whole)task->max_steps), over = step >= most;
  end = select_whole(over & (skipped > 0), every(TIMEOUT), end);
  lanes->step = select_whole(here, select_whole(over, most, step), lanes->step);
  lanes->status = select_whole(here, end, lanes->status);
  return here & (over | (end != 0));
}
#endif
