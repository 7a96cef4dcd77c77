/* The kinds of compiled actions, and the parts of rollouts that can be timed. */
#pragma once

/* RECURRENT and DELAY have a memory, which only the lanes of resumable.h have. */
enum {
  MOVE_BASE, DETECT, GRASP, CONTINUOUS, BRANCHING, EDGE, EDGE_WAY, EDGE_BRANCHING, RECURRENT,
  DELAY, IN_PYTHON
};
enum { IN_GAMMA, IN_C, IN_NETWORKS, IN_POSSIBLE, PARTS };
