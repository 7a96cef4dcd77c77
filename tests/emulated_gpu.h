/* What CUDA has, on a CPU: the threads of a block are contexts that take turns, and those of a warp
   wait for each other where they exchange numbers, as on a GPU. */
#pragma once
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <tuple>
#include <ucontext.h>
#include <vector>

#define __CUDACC__
#define __global__
#define __shared__ static /* by the threads of a block; blocks come one after the other */
#define DYNAMIC_SHARED extern
#define __grid_constant__
#define __launch_bounds__(...)

struct Place {
  unsigned x;
};
static Place blockIdx, blockDim, gridDim;

struct Warp {
  uint64_t given[2][32]; /* of an exchange and of the one before, which some have still to read */
  long arrived;
};
struct Thread {
  ucontext_t context;
  std::vector<char> stack;
  Place place;
  long exchanges, barriers;
  bool done;
};
static std::vector<Thread> threads;
static std::vector<Warp> warps;
static long at_barrier;
static unsigned current;
static ucontext_t scheduler;
#define threadIdx (threads[current].place)

static void wait_a_turn() {
  unsigned mine = current;
  swapcontext(&threads[mine].context, &scheduler);
}
static void __syncthreads() {
  long wanted = ++threads[current].barriers * (long)blockDim.x;
  at_barrier++;
  while (at_barrier < wanted) wait_a_turn();
}

/* What each thread of the warp has given, once all have. */
static const uint64_t *exchanged(uint64_t mine) {
  Thread &me = threads[current];
  Warp &warp = warps[current / 32];
  uint64_t *given = warp.given[me.exchanges & 1];
  given[current % 32] = mine;
  long wanted = ++me.exchanges * 32;
  warp.arrived++;
  while (warp.arrived < wanted) wait_a_turn();
  return given;
}
static void full(unsigned mask) {
  if (mask != 0xFFFFFFFFu) abort();
}
template <class T> static T __shfl_sync(unsigned mask, T mine, int from) {
  full(mask);
  uint64_t bits = 0;
  memcpy(&bits, &mine, sizeof mine);
  const uint64_t *given = exchanged(bits);
  memcpy(&mine, given + (from & 31), sizeof mine);
  return mine;
}
template <class T> static T __shfl_xor_sync(unsigned mask, T mine, int by) {
  return __shfl_sync(mask, mine, (int)(current % 32) ^ by);
}
static unsigned __ballot_sync(unsigned mask, int yes) {
  full(mask);
  const uint64_t *given = exchanged(yes != 0);
  unsigned bits = 0;
  for (int i = 0; i < 32; i++) bits |= (unsigned)given[i] << i;
  return bits;
}
static int __any_sync(unsigned mask, int yes) { return __ballot_sync(mask, yes) != 0; }
static void __syncwarp() { __ballot_sync(0xFFFFFFFFu, 0); }
template <class T> static T atomicAdd(T *to, T more) {
  T before = *to;
  *to += more;
  return before;
}
static int __popc(unsigned bits) { return __builtin_popcount(bits); }
static int __clz(int bits) { return bits ? __builtin_clz((unsigned)bits) : 32; }
static int __ffs(int bits) { return __builtin_ffs(bits); }
static int __ffsll(long long bits) { return __builtin_ffsll(bits); }

static void (*body)(void *);
static void *arguments;
static void begin_thread() {
  body(arguments);
  threads[current].done = true;
  setcontext(&scheduler);
}
static void run_block(unsigned count) {
  threads.resize(count);
  warps.assign((count + 31) / 32, Warp());
  at_barrier = 0;
  for (unsigned i = 0; i < count; i++) {
    Thread &t = threads[i];
    t.stack.resize(1 << 18);
    t.place = {i}, t.exchanges = t.barriers = 0, t.done = false;
    getcontext(&t.context);
    t.context.uc_stack.ss_sp = t.stack.data(), t.context.uc_stack.ss_size = t.stack.size();
    t.context.uc_link = nullptr;
    makecontext(&t.context, begin_thread, 0);
  }
  for (bool going = true; going;) {
    going = false;
    for (current = 0; current < count; current++)
      if (!threads[current].done) {
        going = true;
        swapcontext(&scheduler, &threads[current].context);
      }
  }
}

/* Calls a kernel with arguments of which there are addresses. */
template <class... Types> struct Call {
  void (*kernel)(Types...);
  void **given;
  template <size_t... I> void with(std::index_sequence<I...>) const {
    kernel(*static_cast<std::remove_const_t<Types> *>(given[I])...);
  }
  static void make(void *what) {
    static_cast<Call *>(what)->with(std::index_sequence_for<Types...>());
  }
};
template <class... Types>
static void launch(void (*kernel)(Types...), unsigned blocks, unsigned count, void **given) {
  Call<Types...> call = {kernel, given};
  body = Call<Types...>::make, arguments = &call;
  gridDim = {blocks}, blockDim = {count};
  for (unsigned b = 0; b < blocks; b++) blockIdx = {b}, run_block(count);
}
