/* Where the frames of an arm's chain are (cgtorch.tabletop.kinematics.arm.ChainTable). */
#pragma once
#include "real.h"

#define MOST_FRAMES 64

enum { FIXED, REVOLUTE, PRISMATIC };

/* A chain of frames, each in the one before and moved by a joint. Poses are rows of (3, 4). */
typedef struct {
  const real *offset, *axis;   /* (F, 3, 4), the first in the robot's base; (F, 3) of joints */
  const int64_t *kind, *joint; /* (F,) kind and column of each frame's joint */
  int64_t frames, joints;
} Chain;

static inline real dot(const real *a, const real *b) {
  return FMA(a[2], b[2], FMA(a[1], b[1], a[0] * b[0]));
}

/* a b, where what is below their rows is 0 0 0 1. */
static inline void product(const real *a, const real *b, real *out) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++)
      out[i * 4 + j] = FMA(a[i * 4 + 2], b[8 + j], FMA(a[i * 4 + 1], b[4 + j], a[i * 4] * b[j])) +
                       (j == 3 ? a[i * 4 + 3] : 0);
}

/* The pose that a joint at `q` gives what it moves: Rodrigues' formula, or a shift. */
static inline void moved(int64_t kind, const real *axis, real q, real *out) {
  real sine = kind == REVOLUTE ? (real)sin((double)q) : 0, cosine = kind == REVOLUTE ? (real)cos((double)q) : 1;
  real x = axis[0], y = axis[1], z = axis[2], rest = 1 - cosine, shift = kind == PRISMATIC ? q : 0;
  const real pose[12] = {
      cosine + rest * x * x,   rest * x * y - sine * z, rest * x * z + sine * y, shift * x,
      rest * x * y + sine * z, cosine + rest * y * y,   rest * y * z - sine * x, shift * y,
      rest * x * z - sine * y, rest * y * z + sine * x, cosine + rest * z * z,   shift * z};
  for (int i = 0; i < 12; i++) out[i] = pose[i];
}

static void poses_of(const Chain *chain, const real *q, real poses[][12]) {
  for (int64_t f = 0; f < chain->frames; f++) {
    real local[12], joint[12];
    const real *offset = chain->offset + f * 12, *here = offset;
    if (chain->kind[f] != FIXED) {
      moved(chain->kind[f], chain->axis + f * 3, q[chain->joint[f]], joint);
      product(offset, joint, local);
      here = local;
    }
    if (f) product(poses[f - 1], here, poses[f]);
    else
      for (int i = 0; i < 12; i++) poses[f][i] = here[i];
  }
}

static inline void placed(const real *pose, const real *point, real *out) {
  for (int i = 0; i < 3; i++)
    out[i] = dot(pose + i * 4, point) + pose[i * 4 + 3];
}
