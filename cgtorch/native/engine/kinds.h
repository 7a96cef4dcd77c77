/* The kinds of actions that compiled rollouts know, and the parts of them that can be timed. */
#pragma once

/* RECURRENT and DELAY have a memory, which lanes of resumable.h alone have. */
enum {
  MOVE_BASE, DETECT, GRASP, CONTINUOUS, BRANCHING, EDGE, EDGE_WAY, EDGE_BRANCHING, RECURRENT,
  DELAY, IN_PYTHON
};
enum { IN_GAMMA, IN_C, IN_NETWORKS, IN_POSSIBLE, PARTS };
