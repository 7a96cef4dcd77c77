/* Children on a GPU: crossover and mutation of a pair by a thread, parameters of a child by a warp
   (cgtorch.evolution.gpu). */
#include "real.h"
#include "engine/operators.h"

INLINE int64_t thread_of_grid(void) { return (int64_t)blockIdx.x * blockDim.x + threadIdx.x; }

KERNEL elite(const __grid_constant__ Breeding b) {
  int64_t row = thread_of_grid();
  if (row < b.elites) copy_elite(&b, row);
}

KERNEL pairs(const __grid_constant__ Breeding b) {
  int64_t pair = thread_of_grid();
  if (pair < b.pairs) make_pair(&b, pair);
}

KERNEL children(const __grid_constant__ Children c) {
  int64_t row = thread_of_grid() / WARP, k = c.most;
  if (row >= c.rows) return;
  int me = thread_of_warp();
  const float *strategy = c.strategy + row * STRATEGY;
  uint64_t key = key_of(c.key, row), limit = row < c.same ? 0 : below(strategy[MUTATE_PARAMETER]);
  for (int64_t i = row * c.nodes, first = 0; i < (row + 1) * c.nodes; i++) {
    int64_t count = parameters_at(&c, i);
    const real *from = origin_of(&c, i);
    for (int64_t j = me; j < k; j += WARP) {
      real x = j >= count ? 0 : from ? from[j] : fresh_number(&c, key, row, i, j);
      uint64_t drawn = word(key, first + j);
      if (j < count && drawn >> (64 - BITS) < limit) x += normal(c.quantiles, drawn) * strategy[SIGMA];
      c.parameters[i * k + j] = x;
    }
    first += count;
  }
  if (me < STRATEGY) c.drifted[row * STRATEGY + me] = drifted(&c, key, row, me);
}
