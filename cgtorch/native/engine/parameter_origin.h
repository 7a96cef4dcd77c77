/* Where the parameters of a node come from (cgtorch.evolution.parameters): r + 1 for row r of those of
   all parents, -r - 1 for row r of those drawn for new nodes, 0 for a new node without a number. */
#ifndef CGTORCH_PARAMETER_ORIGIN_H
#define CGTORCH_PARAMETER_ORIGIN_H
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Numbers new nodes -1, -2, ..., first those of action 0, and so on, and tells after how many those
   of each action begin; the last of `first` (A + 1,) is how many there are. 0 for want of memory. */
static int number_new_nodes(const int64_t *action, int64_t *origins, int64_t total, int64_t actions,
                            int64_t *first) {
  int64_t count = 0, *where = malloc((size_t)(total + 1) * sizeof *where);
  if (!where) return 0;
  memset(first, 0, (size_t)(actions + 1) * sizeof *first);
  for (int64_t i = 0; i < total; i++)
    if (!origins[i] && action[i] >= 0 && action[i] < actions) {
      where[count++] = i;
      origins[i] = -++first[action[i] + 1];
    }
  for (int64_t a = 0; a < actions; a++) first[a + 1] += first[a];
  for (int64_t i = 0; i < count; i++) origins[where[i]] -= first[action[where[i]]];
  free(where);
  return 1;
}
#endif
