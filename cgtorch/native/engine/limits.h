/* How much there is room for. What needs more runs in torch. */
#pragma once

#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define MOST_PERCEPT 64
#define MOST_HIDDEN 64
#define MOST_SEEN (MOST_PERCEPT + 9) /* numbers that a network reads */
#define MOST_WEIGHTS (MOST_HIDDEN * (MOST_SEEN + 1) + MOST_MESSAGE * (MOST_HIDDEN + 1))

/* What takes long is kept out of the loops that call it, whose registers it would take. */
#define APART static __attribute__((noinline))
