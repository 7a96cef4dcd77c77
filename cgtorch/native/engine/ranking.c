/* Individuals from best to worst (cgtorch.evolution.selection.ranking). */
#include "graph.h"
#include "order.h"
#include "library.h"
#include <stdlib.h>

#define DIGIT 11 /* bits that are sorted by at once */
#define BUCKETS (1 << DIGIT)

/* A key that is smaller for larger numbers, the same for both zeros, and smallest for NaN. */
static uint64_t downwards(real x) { return x == x ? (pattern)~ordered(x + 0) : 0; }

/* Sorts `order` by ascending key, stably, digit by digit where digits differ. Returns the array with the
   result. */
static int64_t *sorted(const uint64_t *key, int64_t count, int64_t *order, int64_t *other) {
  uint64_t any = 0, all = ~(uint64_t)0;
  for (int64_t i = 0; i < count; i++) any |= key[i], all &= key[i];
  for (int shift = 0; shift < 64; shift += DIGIT) {
    if (!((any & ~all) >> shift & (BUCKETS - 1))) continue;
    int64_t first[BUCKETS + 1] = {0}, *swap = order;
    for (int64_t i = 0; i < count; i++) first[(key[i] >> shift & (BUCKETS - 1)) + 1]++;
    for (int b = 0; b < BUCKETS; b++) first[b + 1] += first[b];
    for (int64_t i = 0; i < count; i++)
      other[first[key[order[i]] >> shift & (BUCKETS - 1)]++] = order[i];
    order = other;
    other = swap;
  }
  return order;
}

/* Indices (count,) by fitness; of equal ones by the number of nodes in actions (count, nodes), then by index.
   */
int ranking(const real *fitness, const int64_t *action, int64_t nodes, int64_t count, int64_t *out) {
  uint64_t *key = malloc((size_t)(3 * count + 1) * sizeof *key);
  if (!key) return NO_MEMORY;
  int64_t *order = (int64_t *)key + count, *other = order + count;
  for (int64_t i = 0; i < count; i++) {
    order[i] = i, key[i] = 0;
    for (int64_t j = 0; j < nodes; j++) key[i] += action[i * nodes + j] != NO_NODE;
  }
  int64_t *found = sorted(key, count, order, other);
  for (int64_t i = 0; i < count; i++) key[i] = downwards(fitness[i]);
  found = sorted(key, count, found, found == order ? other : order);
  memcpy(out, found, (size_t)count * sizeof *out);
  free(key);
  return 0;
}
