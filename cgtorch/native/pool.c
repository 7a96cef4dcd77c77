/* Threads that are kept from one call to the next: making one takes as long as a hundred rollouts. */
#define _POSIX_C_SOURCE 200809L /* of sigset_t */
#include "parallel.h"

#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>

#define MOST_THREADS 256
#define SPINS 4000 /* of pause, about a tenth of a millisecond, after which who waits sleeps */

typedef struct {
  Piece piece;
  void *what;
  int64_t total, size;
  _Atomic int64_t next;
} Work;

static struct {
  pthread_mutex_t lock, caller; /* of all below; of who gives work */
  pthread_cond_t given, done;
  Work *work;             /* NULL where there is none to join */
  int64_t seats;          /* how many may still join */
  _Atomic int64_t turn;   /* how often work was given */
  _Atomic int64_t joined; /* workers that are at it */
  int64_t workers;
} pool = {.lock = PTHREAD_MUTEX_INITIALIZER,
          .caller = PTHREAD_MUTEX_INITIALIZER,
          .given = PTHREAD_COND_INITIALIZER,
          .done = PTHREAD_COND_INITIALIZER};

static void relax(void) {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

static void work_off(Work *work) {
  for (;;) {
    int64_t begin = atomic_fetch_add(&work->next, work->size), end = begin + work->size;
    if (begin >= work->total) return;
    work->piece(work->what, begin, end < work->total ? end : work->total);
  }
}

static void *worker(void *argument) {
  int64_t seen = (int64_t)(intptr_t)argument;
  for (;;) {
    for (int i = 0; i < SPINS && atomic_load(&pool.turn) == seen; i++) relax();
    pthread_mutex_lock(&pool.lock);
    while (atomic_load(&pool.turn) == seen) pthread_cond_wait(&pool.given, &pool.lock);
    seen = atomic_load(&pool.turn);
    Work *work = pool.seats > 0 ? pool.work : NULL;
    if (work) pool.seats--, atomic_fetch_add(&pool.joined, 1);
    pthread_mutex_unlock(&pool.lock);
    if (!work) continue;
    work_off(work);
    pthread_mutex_lock(&pool.lock);
    if (atomic_fetch_sub(&pool.joined, 1) == 1) pthread_cond_signal(&pool.done);
    pthread_mutex_unlock(&pool.lock);
  }
  return NULL;
}

/* A child has none of its parent's threads, and locks as they happened to be. */
static void in_child(void) {
  pthread_mutex_init(&pool.lock, NULL), pthread_mutex_init(&pool.caller, NULL);
  pthread_cond_init(&pool.given, NULL), pthread_cond_init(&pool.done, NULL);
  pool.work = NULL, pool.workers = 0;
  atomic_store(&pool.joined, 0);
}

static void once_only(void) { pthread_atfork(NULL, NULL, in_child); }

/* `count` workers, or as many as there can be; the lock is held. Signals are for other threads. */
static void hire(int64_t count) {
  static pthread_once_t once = PTHREAD_ONCE_INIT;
  if (pool.workers >= count) return;
  sigset_t every, before;
  pthread_once(&once, once_only);
  sigfillset(&every);
  pthread_sigmask(SIG_BLOCK, &every, &before);
  for (; pool.workers < count; pool.workers++) {
    pthread_t thread;
    if (pthread_create(&thread, NULL, worker, (void *)(intptr_t)atomic_load(&pool.turn))) break;
    pthread_detach(thread);
  }
  pthread_sigmask(SIG_SETMASK, &before, NULL);
}

void in_parallel(Piece piece, void *what, int64_t total, int64_t size, int64_t threads) {
  Work work = {piece, what, total, size, 0};
  int64_t parts = (total + size - 1) / size, others = (threads < parts ? threads : parts) - 1;
  if (others > MOST_THREADS) others = MOST_THREADS;
  /* Who comes while the workers are taken works alone. */
  if (others <= 0 || pthread_mutex_trylock(&pool.caller)) {
    work_off(&work);
    return;
  }
  pthread_mutex_lock(&pool.lock);
  hire(others);
  pool.work = &work, pool.seats = others;
  atomic_fetch_add(&pool.turn, 1);
  pthread_cond_broadcast(&pool.given);
  pthread_mutex_unlock(&pool.lock);
  work_off(&work);
  pthread_mutex_lock(&pool.lock);
  pool.work = NULL; /* who has not come by now has nothing to do here */
  pthread_mutex_unlock(&pool.lock);
  for (int i = 0; i < SPINS && atomic_load(&pool.joined); i++) relax();
  pthread_mutex_lock(&pool.lock);
  while (atomic_load(&pool.joined)) pthread_cond_wait(&pool.done, &pool.lock);
  pthread_mutex_unlock(&pool.lock);
  pthread_mutex_unlock(&pool.caller);
}
