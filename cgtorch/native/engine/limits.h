/* Sizes that compiled code supports. Larger ones run in torch. For a GPU, sizes are those needed. */
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
