/* Structures and constants shared by Python and rollouts. */
#include "library.h"
#include "lanes.h"

EXPORT_STRUCT(Action)
EXPORT_STRUCT(Program)
EXPORT_STRUCT(ModelEnvironment)
EXPORT_STRUCT(Task)
EXPORT_STRUCT(Launch)
EXPORT_CONSTANTS(counts, NEXT_OF_W, NEXT, COUNTED, EXECUTED, NUM_NOT_FINITE, WRONG, COUNTS)
EXPORT_CONSTANTS(action_kinds, STEP, PERCEIVE, TEST, CONTINUOUS, BRANCHING, DOMAIN_NN, DOMAIN_OTHER_NN,
                 DOMAIN_BRANCHING, RECURRENT, DELAY, IN_PYTHON)
EXPORT_CONSTANTS(ends, SUCCESS, FAILURE, TIMEOUT)
EXPORT_CONSTANTS(engine_limits, MOST_PERCEPT, MOST_MESSAGE, MOST_HIDDEN, MOST_READ, MOST_SENT,
                 MOST_DELAYED, MOST_DEPTH)

/* Whether any of `count` nodes has a flagged action; an invalid action has the last flag. */
int any_flagged(const int64_t *action, int64_t count, const int64_t *flags, int64_t actions) {
  int64_t found = 0;
  for (int64_t i = 0; i < count; i++) {
    int64_t a = action[i] < 0 || action[i] >= actions ? actions : action[i];
    found |= flags[a];
  }
  return found != 0;
}
