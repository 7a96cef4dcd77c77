/* Pieces of work shared out among threads that take them off one counter. */
#ifndef CGTORCH_PARALLEL_H
#define CGTORCH_PARALLEL_H
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>

#define MOST_THREADS 256

typedef void (*Piece)(void *what, int64_t begin, int64_t end);

typedef struct {
  Piece piece;
  void *what;
  int64_t total, size;
  _Atomic int64_t next;
} Work;

static void *work_off(void *argument) {
  Work *work = argument;
  for (;;) {
    int64_t begin = atomic_fetch_add(&work->next, work->size), end = begin + work->size;
    if (begin >= work->total) return NULL;
    work->piece(work->what, begin, end < work->total ? end : work->total);
  }
}

/* Calls `piece` on [0, total) in parts of `size`, in `threads` threads, and waits for all. */
static void in_parallel(Piece piece, void *what, int64_t total, int64_t size, int threads) {
  Work work = {piece, what, total, size, 0};
  pthread_t others[MOST_THREADS];
  int64_t parts = (total + size - 1) / size, count = 0;
  if (threads > MOST_THREADS) threads = MOST_THREADS;
  for (int64_t i = 1; i < threads && i < parts; i++, count++)
    if (pthread_create(&others[count], NULL, work_off, &work)) break;
  work_off(&work);
  for (int64_t i = 0; i < count; i++) pthread_join(others[i], NULL);
}
#endif
