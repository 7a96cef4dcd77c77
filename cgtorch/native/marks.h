/* Marks of nodes, which say where their parameters come from (cgtorch.evolution.parameters). */
#ifndef CGTORCH_MARKS_H
#define CGTORCH_MARKS_H
#include <stdint.h>

/* Marks nodes that have no mark with -1, -2, ..., first those of action 0, and so on, and tells after
   how many those of each action begin; the last of `first` (A + 1,) is how many there are. 1 for want
   of memory. */
int mark_new(const int64_t *action, int64_t *marks, int64_t total, int64_t actions, int64_t *first);
#endif
