/* What Python and rollouts have in common. */
#include "library.h"
#include "kinds.h"
#include "task.h"

EXPORT_STRUCT(Action)
EXPORT_STRUCT(Program)
EXPORT_STRUCT(ModelEnvironment)
EXPORT_STRUCT(Task)
EXPORT_CONSTANTS(action_kinds, MOVE_BASE, DETECT, GRASP, CONTINUOUS, BRANCHING, EDGE, EDGE_BRANCHING,
                 IN_PYTHON)
EXPORT_CONSTANTS(ends, SUCCESS, FAILURE, TIMEOUT)
EXPORT_CONSTANTS(engine_limits, MOST_PERCEPT, MOST_MESSAGE, MOST_HIDDEN, MOST_DEPTH)
