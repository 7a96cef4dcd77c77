/* The tabletop for rollouts (engine/models.h). */
#pragma once
#include "engine/program.h"
#include "engine/models.h"
#include "models.h"
#include "routes.h"

typedef struct {
  Gamma gamma;
  Classifier classifier;
  Body body;
} TabletopModels;

typedef TabletopModels Models;
typedef Edge View;

INLINE vwhole possible(const void *models, Layout layout, const vec *percept, const vec *control,
                       vwhole rows) {
  return motion_possible(percept, control, layout, &((const Models *)models)->body, rows);
}
INLINE void next_percept(const void *models, Layout layout, const vec *percept, const vec *control,
                         uint32_t bits, vec *after, vec *novelty) {
  gamma_vec(&((const Models *)models)->gamma, layout, percept, control, bits, after, novelty);
}
INLINE vec chance_of(const void *models, Layout layout, const vec *percept, uint32_t bits) {
  return success_vec(&((const Models *)models)->classifier, layout, percept, bits);
}

/* Percepts unchanged, or in the frame of the nearest edge. */
INLINE const vec *looked_at(int64_t kind, Layout layout, const vec *percept, vec *seen, View *edge) {
  if (kind != DOMAIN_NN && kind != DOMAIN_OTHER_NN && kind != DOMAIN_BRANCHING) return percept;
  *edge = edge_frame(percept, layout);
  table_scene(edge, percept, seen);
  if (kind == DOMAIN_BRANCHING) obstacle_scene(edge, percept, layout, seen + SCENE);
  return seen;
}
INLINE void said(const void *models, int64_t kind, Layout layout, const vec *percept, const View *edge,
                 vwhole rows, vec *out) {
  if (kind != DOMAIN_NN && kind != DOMAIN_OTHER_NN) return;
  vec pose[3] = {out[0], out[1], out[2]};
  motion_to(edge, pose, out);
  if (kind == DOMAIN_OTHER_NN) first_motion(percept, layout, &((const Models *)models)->body, rows, out);
}
