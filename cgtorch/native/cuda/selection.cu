/* Epsilon-lexicase selection on a GPU (engine/selection.c): a block sorts a group, a warp selects a parent. */
#include "real.h"
#include "engine/selection.h"

INLINE int64_t thread_of_grid(void) { return (int64_t)blockIdx.x * blockDim.x + threadIdx.x; }
INLINE int64_t at_most(int64_t a, int64_t b) { return a < b ? a : b; }

/* Where part `part` begins, if the first `larger` parts have one more element than the others. */
INLINE int64_t begin_of(int64_t part, int64_t smaller, int64_t larger) {
  return part * smaller + at_most(part, larger);
}

KERNEL order(int64_t *out, const int64_t count, const uint64_t key) {
  int64_t i = thread_of_grid();
  if (i < count) out[i] = shuffled(i, count, key);
}

KERNEL sort_groups(const __grid_constant__ Groups g) {
  __shared__ uint64_t hash[CANDIDATES];
  __shared__ int first[CANDIDATES];
  int64_t group = blockIdx.x, begin = begin_of(group, g.smaller, g.larger), b = g.scenarios;
  int size = (int)(g.smaller + (group < g.larger));
  const real *scores = g.scores + begin * b;
  for (int i = threadIdx.x; i < size; i += blockDim.x) hash[i] = hash_of(scores + i * b, b);
  __syncthreads();
  for (int i = threadIdx.x; i < size; i += blockDim.x) {
    int j = 0;
    while (j < i && (hash[j] != hash[i] || !alike(scores + j * b, scores + i * b, b))) j++;
    first[i] = j;
  }
  __syncthreads();
  for (int i = threadIdx.x; i < CANDIDATES; i += blockDim.x) {
    int place = i < size ? 0 : i;
    for (int j = 0; i < size && j < size; j++)
      place += first[j] < first[i] || (first[j] == first[i] && j < i);
    g.ordered[group * CANDIDATES + place] = i;
    g.leader[group * CANDIDATES + place] = i < size ? first[i] : -1;
    for (int64_t s = 0; s < b; s++)
      g.cases[(group * b + s) * CANDIDATES + place] = i < size ? scores[i * b + s] : -(real)INFINITY;
  }
}

/* The surviving candidates: bit c of thread t is candidate 32 c + t; `some` has, in all threads, a bit for
   each c with a survivor. */
typedef struct {
  uint32_t mine, some;
} Survivors;

INLINE Survivors survivors_of(uint32_t mine) {
  Survivors s = {mine, 0};
  for (int c = 0; c < CANDIDATES / WARP; c++)
    s.some |= (uint32_t)__any_sync(EVERYONE, mine >> c & 1) << c;
  return s;
}
/* The survivors whose score is at most `epsilon` below the best. */
INLINE Survivors survivors_of_case(Survivors s, const real *score, real epsilon) {
  real best = -(real)INFINITY;
  int me = thread_of_warp();
  for (uint32_t rest = s.some; rest; rest &= rest - 1) {
    int c = __ffs((int)rest) - 1;
    if (s.mine >> c & 1 && score[c * WARP + me] > best) best = score[c * WARP + me];
  }
  for (int by = WARP / 2; by; by /= 2) {
    real other = __shfl_xor_sync(EVERYONE, best, by);
    if (other > best) best = other;
  }
  uint32_t some = 0;
  for (uint32_t rest = s.some; rest; rest &= rest - 1) {
    int c = __ffs((int)rest) - 1;
    if (!(score[c * WARP + me] >= best - epsilon)) s.mine &= ~(1u << c);
    if (__any_sync(EVERYONE, s.mine >> c & 1)) some |= 1u << c;
  }
  s.some = some;
  return s;
}
/* Whether all survivors have the same scores; candidates are ordered by the first one with their scores. */
INLINE int all_alike(Survivors s, const int32_t *leader) {
  if (!s.some) return 1;
  int low = __ffs((int)s.some) - 1, high = 31 - __clz((int)s.some);
  uint32_t first = __ballot_sync(EVERYONE, s.mine >> low & 1), last = __ballot_sync(EVERYONE, s.mine >> high & 1);
  return leader[low * WARP + __ffs((int)first) - 1] == leader[high * WARP + 31 - __clz((int)last)];
}
/* The survivor number `place`; and the number of survivors. */
INLINE int candidate(Survivors s, int64_t place) {
  for (uint32_t rest = s.some; rest; rest &= rest - 1) {
    int c = __ffs((int)rest) - 1;
    uint32_t here = __ballot_sync(EVERYONE, s.mine >> c & 1);
    if (place < __popc(here)) {
      for (; place; place--) here &= here - 1;
      return c * WARP + __ffs((int)here) - 1;
    }
    place -= __popc(here);
  }
  return 0;
}
INLINE int64_t how_many(Survivors s) {
  int count = __popc(s.mine);
  for (int by = WARP / 2; by; by /= 2) count += __shfl_xor_sync(EVERYONE, count, by);
  return count;
}

/* The next scenario, the same for all threads of a warp; the first one shuffles. */
INLINE int64_t next_of_warp(int32_t *case_order, int64_t scenarios, int64_t place_in_order, uint64_t key) {
  int64_t found = 0;
  if (thread_of_warp() == 0) found = next_case(case_order, scenarios, place_in_order, key);
  return __shfl_sync(EVERYONE, found, 0);
}

INLINE void choose(const Groups *g, int64_t group, int64_t parent, int64_t to, int32_t *case_order) {
  int64_t b = g->scenarios, begin = begin_of(group, g->smaller, g->larger);
  int size = (int)(g->smaller + (group < g->larger)), me = thread_of_warp();
  uint64_t key = key_of(g->keys[group], parent);
  uint32_t mine = 0;
  for (int64_t s = me; s < b; s += WARP) case_order[s] = (int32_t)s;
  for (int c = 0; c < CANDIDATES / WARP; c++) mine |= (uint32_t)(c * WARP + me < size) << c;
  __syncwarp();
  Survivors survivors = survivors_of(mine);
  for (int64_t place_in_order = 0; place_in_order < b; place_in_order++) {
    int64_t scenario = next_of_warp(case_order, b, place_in_order, key), row = group * b + scenario;
    survivors = survivors_of_case(survivors, g->cases + row * CANDIDATES, g->epsilon[row]);
    if (all_alike(survivors, g->leader + group * CANDIDATES)) break;
  }
  int64_t place = (int64_t)(fine(key, b) * (double)how_many(survivors));
  int found = candidate(survivors, place);
  if (me == 0) g->chosen[to] = g->members[begin + g->ordered[group * CANDIDATES + found]];
}

KERNEL parents(const __grid_constant__ Groups g) {
  int64_t warp = thread_of_grid() / WARP, smaller = g.count / g.groups, larger = g.count % g.groups;
  if (warp >= g.warps) return;
  for (int64_t to = warp; to < g.count; to += g.warps) {
    int64_t many = larger * (smaller + 1);
    int64_t group = to < many ? to / (smaller + 1) : larger + (to - many) / smaller;
    choose(&g, group, to - begin_of(group, smaller, larger), to, g.case_order + warp * g.scenarios);
    __syncwarp();
  }
}
