/* The arguments of kernels beside the task. */
#pragma once
#ifndef __CUDACC_RTC__
#include <stdint.h>
#endif

/* Scenarios [begin, end) of each graph are run, by at most `most` threads of each warp. */
typedef struct {
  int32_t *lost, *bad; /* (P,) whether a graph has lost W; BAD_NUMBERS, NOT_FINITE or 0 */
  int64_t *counts;     /* of the enum below */
  int64_t begin, end, most;
} Launch;

enum { BAD_NUMBERS = 1, NOT_FINITE = 2 };
enum { NEXT_OF_W, NEXT, COUNTED, EXECUTED, NUM_NOT_FINITE, WRONG, COUNTS };
