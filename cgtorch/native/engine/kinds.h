/* The kinds of compiled actions, and the parts of rollouts that can be timed. */
#pragma once

/* RECURRENT and DELAY have a memory, which only the lanes of resumable.h have. Inputs and outputs of
   the kinds DOMAIN_... are mapped by the code of a domain. */
enum {
  STEP, PERCEIVE, TEST, CONTINUOUS, BRANCHING, DOMAIN_NN, DOMAIN_OTHER_NN, DOMAIN_BRANCHING, RECURRENT,
  DELAY, IN_PYTHON
};
enum { IN_GAMMA, IN_C, IN_NETWORKS, IN_POSSIBLE, PARTS };
