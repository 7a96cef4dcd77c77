/* How much there is room for. What needs more runs in torch. For a GPU there is as much as is needed. */
#pragma once

#ifndef MOST_DEPTH
#define MOST_DEPTH 16
#define MOST_MESSAGE 16
#define MOST_PERCEPT 64
#define MOST_HIDDEN 64
#endif
#define MOST_DELAYED 256 /* numbers of a percept and its changes */
#define MOST_SEEN (MOST_PERCEPT + 9) /* numbers that a network reads */
#define MOST_WEIGHTS (MOST_HIDDEN * (MOST_SEEN + 1) + MOST_MESSAGE * (MOST_HIDDEN + 1))
