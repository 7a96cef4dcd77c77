/* A vector of lanes. */
#pragma once
#include "models.h"
#include "program.h"

/* Up to WIDTH lanes. Each part of a vector belongs to one lane; lanes are independent. */
typedef struct {
  whole caller[MOST_DEPTH][WIDTH], outer[MOST_DEPTH][WIDTH]; /* what is left on the levels without */
  vec message[MOST_MESSAGE], moves, lost, chance;            /* the state of `ModelEnvironment` */
  vwhole has_message;                                        /* whether there is a message */
  vwhole scenario, step, node, level, left; /* `left`: transitions on this level */
  vwhole executed; /* of `step` those that were made, not only counted */
  vwhole visited;  /* a bit for each node it was at since anything has changed, on this level */
  vwhole status;
  vec percept[MOST_PERCEPT];
} Lanes;

/* Copies lanes; outer levels need no values at the beginning. */
INLINE void copy_lanes(const Lanes *from, int size, Lanes *to) {
  const char *first = (const char *)from->message, *end = (const char *)(from->percept + size);
  memcpy((char *)to->message, first, (size_t)(end - first));
}
