/* The interface of learned models for rollouts: cgtorch.simulation.ModelEnvironment.

   A source that runs rollouts in models of its own defines, before it includes rollout.h or
   resumable.h:

     Models, Layout, View   structures: what its models need, what the size of percepts says of them,
                            and what a network's input leaves for its output
     layout_of(size)
     possible(models, layout, percept, control, rows)   those of `rows` whose controls can be done
     next_percept(models, layout, percept, control, bits, after, novelty)   Γ
     chance_of(models, layout, percept, bits)   C
     looked_at(kind, layout, percept, seen, view)   the columns that a network of a kind reads
     said(models, kind, layout, percept, view, rows, out)   turns what the network says into a message

   All of them take a vector of lanes at once. `bits` or `rows` are those that count; what comes out of
   others is never looked at. */
#pragma once
#include "program.h"

#define UNKNOWN (-1)

typedef struct {
  const void *models;
  const real *percepts, *state, *errors; /* (B, D), (B, 3), (B, T, D) or NULL */
  int64_t size, error_draws, controls;         /* D, T, U */
  real most_novel;
} ModelEnvironment;
