/* An arm: the frames of its chain (cgtorch.tabletop.kinematics.arm.ChainTable), and inverse kinematics in
   closed form. */
#pragma once
#include "real.h"

#define MOST_FRAMES 128
#define FORM_JOINTS 7
#define FULL_TURN (real)6.28318530717958647693
#define FORM_TOLERANCE (real)1e-6

enum { FIXED, REVOLUTE, PRISMATIC };

/* A chain of frames, each relative to the one before and moved by a joint or by what follows one. Poses are rows
   of (3, 4). */
typedef struct {
  const real *offset, *axis;   /* (F, 3, 4), the first in the robot's base; (F, 3) of joints */
  const int64_t *kind, *joint; /* (F,) kind and column of each frame's joint */
  const real *gain;            /* (F,) how far a unit of the column moves it */
  int64_t frames, joints;
} Chain;

static inline real dot(const real *a, const real *b) {
  return FMA(a[2], b[2], FMA(a[1], b[1], a[0] * b[0]));
}

/* The product a b, with 0 0 0 1 below the rows of each. */
static inline void product(const real *a, const real *b, real *out) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++)
      out[i * 4 + j] = FMA(a[i * 4 + 2], b[8 + j], FMA(a[i * 4 + 1], b[4 + j], a[i * 4] * b[j])) +
                       (j == 3 ? a[i * 4 + 3] : 0);
}

/* The transform of a joint at `q`: Rodrigues' formula, or a translation. */
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
      moved(chain->kind[f], chain->axis + f * 3, q[chain->joint[f]] * chain->gain[f], joint);
      product(offset, joint, local);
      here = local;
    }
    if (f) product(poses[f - 1], here, poses[f]);
    else
      for (int i = 0; i < 12; i++) poses[f][i] = here[i];
  }
}

static inline void minus(const real *a, const real *b, real *out) {
  for (int i = 0; i < 3; i++) out[i] = a[i] - b[i];
}

static inline void placed(const real *pose, const real *point, real *out) {
  for (int i = 0; i < 3; i++)
    out[i] = dot(pose + i * 4, point) + pose[i * 4 + 3];
}

/* ---- Inverse kinematics of arms with a spherical wrist, in one posture at one pan angle ----

   The arm has one joint more than a pose needs. Given the pan angle, the triangle of shoulder, elbow and wrist
   gives the elbow, the sideways part of the wrist's centre the shoulder's roll, the plane of the two the lift,
   and the rotation that is left the three joints of the wrist. */

typedef struct {
  const real *before, *after;           /* (4, 4): before tool after is the wrist in the pan frame */
  const real *shoulder;                 /* (3,) */
  const real *signs, *lower, *upper;    /* (7,) */
  const real *branches, *pans;          /* (S, 3), (P,) angles that are tried */
  int64_t count, samples;               /* S, P */
  double upper_arm, forearm;
} ClosedForm;

static inline void wrist_of(const ClosedForm *form, const real *tool, real *wrist) {
  real pose[12];
  product(form->before, tool, pose), product(pose, form->after, wrist);
}

/* A turn of two coordinates. */
static inline void turned(real cosine, real sine, real *a, real *b) {
  real first = cosine * *a - sine * *b;
  *b = sine * *a + cosine * *b, *a = first;
}

/* Whether joint j's limits hold; its angle is brought within a turn of their middle. */
static inline int within_limits(const ClosedForm *form, int j, real *q) {
  const real low = form->lower[j], high = form->upper[j];
  q[j] += FULL_TURN * FN(rint)(((low + high) / 2 - q[j]) / FULL_TURN);
  return q[j] >= low - FORM_TOLERANCE && q[j] <= high + FORM_TOLERANCE;
}

/* The cosine of the elbow; and where the wrist's centre is, seen from the lift axis. */
static real elbow_of(const ClosedForm *form, real cosine, real sine, const real *wrist, real *at) {
  const real a = (real)form->upper_arm, b = (real)form->forearm;
  for (int i = 0; i < 3; i++) at[i] = wrist[i * 4 + 3];
  turned(cosine, -sine, at, at + 1);
  minus(at, form->shoulder, at);
  return (dot(at, at) - (a * a + b * b)) / (2 * a * b);
}

typedef struct {
  real angle, cosine, sine;
} Pan;

/* Whether there is a solution at a pan angle for a pose of the wrist's last frame (3, 4) in the pan frame;
   writes it. Most fail at a limit, so each angle is checked before the next is computed. */
static int solved(const ClosedForm *form, const real *branch, const Pan *pan, const real *wrist, real *q) {
  const real a = (real)form->upper_arm, b = (real)form->forearm;
  real cos1 = pan->cosine, sin1 = pan->sine, at[3];
  real cos4 = elbow_of(form, cos1, sin1, wrist, at), x = at[0], y = at[1], z = at[2];
  if (!(FN(fabs)(cos4) <= 1)) return 0;
  real sin4 = branch[0] * FN(sqrt)(1 - cos4 * cos4), along = a + b * cos4, drop = -b * sin4;
  real sin3 = -y / drop;
  if (!(FN(fabs)(sin3) <= 1)) return 0;
  real cos3 = branch[1] * FN(sqrt)(1 - sin3 * sin3), down = cos3 * drop;
  real cos2 = along * x + down * z, sin2 = down * x - along * z;
  real length = FN(sqrt)(cos2 * cos2 + sin2 * sin2);
  if (!(length > 0)) return 0;
  cos2 /= length, sin2 /= length;
  q[0] = pan->angle, q[1] = FN(atan2)(sin2, cos2);
  if (!within_limits(form, 0, q) || !within_limits(form, 1, q)) return 0;
  q[2] = FN(atan2)(sin3, cos3);
  if (!within_limits(form, 2, q)) return 0;
  q[3] = FN(atan2)(sin4, cos4);
  if (!within_limits(form, 3, q)) return 0;

  real d[3], e[3]; /* the first two columns, seen from the forearm */
  for (int i = 0; i < 3; i++) d[i] = wrist[4 * i], e[i] = wrist[4 * i + 1];
  for (int i = 0; i < 2; i++) {
    real *c = i ? e : d;
    turned(cos1, -sin1, c, c + 1), turned(cos2, sin2, c, c + 2);
    turned(cos3, -sin3, c + 1, c + 2), turned(cos4, sin4, c, c + 2);
  }
  real away = FN(sqrt)(d[1] * d[1] + d[2] * d[2]), cos5 = 1, sin5 = 0, sin6 = branch[2] * away;
  q[5] = FN(atan2)(sin6, d[0]);
  if (!within_limits(form, 5, q)) return 0;
  if (away >= (real)1e-9) cos5 = -branch[2] * d[2] / away, sin5 = branch[2] * d[1] / away;
  q[4] = FN(atan2)(sin5, cos5);
  if (!within_limits(form, 4, q)) return 0;
  turned(cos5, -sin5, e + 1, e + 2);
  q[6] = FN(atan2)(sin6 * e[0] + d[0] * e[2], e[1]);
  if (!within_limits(form, 6, q)) return 0;
  for (int j = 0; j < FORM_JOINTS; j++) q[j] *= form->signs[j];
  return 1;
}
