/* Exports of constants and sizes, by which Python checks its reading of the sources
   (cgtorch.native.library), and work sharing among threads. */
#pragma once
#include <stddef.h>
#include <stdint.h>

#define EXPORT_STRUCT(name) const int64_t size_of_##name = sizeof(name);
#define EXPORT_CONSTANTS(group, ...)            \
  const char names_of_##group[] = #__VA_ARGS__; \
  const int64_t values_of_##group[] = {__VA_ARGS__};

/* The return values of functions. */
enum { DONE, NO_MEMORY, WRONG_GRAPHS };

/* Pieces of work, which threads take off a common counter (thread_pool.c). */
typedef void (*Piece)(void *what, int64_t begin, int64_t end);

/* Calls `piece` on [0, total) in parts of `size`, in up to `threads` threads, and waits for all. */
void in_parallel(Piece piece, void *what, int64_t total, int64_t size, int64_t threads);

/* Requests pages of 2 MB, as getting 34 MB in pages of 4 kB takes longer than all operators. */
void large_pages(void *memory, size_t bytes);
