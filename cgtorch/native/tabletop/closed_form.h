/* Inverse kinematics of arms with a spherical wrist, in closed form, in one posture at one pan angle (the
   formulas are explained in cgtorch.tabletop.kinematics.inverse_kinematics). */
#pragma once
#include "tabletop/solids.h"

#define FORM_JOINTS 7
#define FULL_TURN (real)6.28318530717958647693
#define FORM_TOLERANCE (real)1e-6

typedef struct {
  const real *before, *after;           /* (4, 4): before tool after is the wrist in the pan frame */
  const real *shoulder;                 /* (3,) */
  const real *signs, *lower, *upper;    /* (7,) */
  const real *branches, *pans;          /* (S, 3), (P,) angles that are tried */
  int64_t count, samples;               /* S, P */
  double upper_arm, forearm;
  double least, most;                   /* cosines of the elbow that the limits allow */
} ClosedForm;

/* A turn of two coordinates. */
static inline void turned(real cosine, real sine, real *a, real *b) {
  real first = cosine * *a - sine * *b;
  *b = sine * *a + cosine * *b, *a = first;
}

/* Whether the limits hold; each angle is brought within a turn of their middle. */
static int within_limits(const ClosedForm *form, real *q) {
  for (int j = 0; j < FORM_JOINTS; j++) {
    real low = form->lower[j], high = form->upper[j];
    q[j] += FULL_TURN * FN(rint)(((low + high) / 2 - q[j]) / FULL_TURN);
    if (!(q[j] >= low - FORM_TOLERANCE && q[j] <= high + FORM_TOLERANCE)) return 0;
    q[j] *= form->signs[j];
  }
  return 1;
}

/* The cosine of the elbow; and where the wrist's centre is, seen from the lift axis. */
static real elbow_of(const ClosedForm *form, real cosine, real sine, const real *wrist, real *at) {
  const real a = (real)form->upper_arm, b = (real)form->forearm;
  for (int i = 0; i < 3; i++) at[i] = wrist[i * 4 + 3];
  turned(cosine, -sine, at, at + 1);
  minus(at, form->shoulder, at);
  return (dot(at, at) - (a * a + b * b)) / (2 * a * b);
}

/* Whether there is a solution at a pan angle for a pose of the wrist's last frame (3, 4) in the pan frame;
   writes it. */
static int solved(const ClosedForm *form, const real *branch, real pan, const real *wrist, real *q) {
  const real a = (real)form->upper_arm, b = (real)form->forearm;
  real cos1 = FN(cos)(pan), sin1 = FN(sin)(pan), at[3];
  real cos4 = elbow_of(form, cos1, sin1, wrist, at), x = at[0], y = at[1], z = at[2];
  if (!(FN(fabs)(cos4) <= 1)) return 0;
  real sin4 = branch[0] * FN(sqrt)(1 - cos4 * cos4), along = a + b * cos4, drop = -b * sin4;
  real sin3 = -y / drop;
  if (!(FN(fabs)(sin3) <= 1)) return 0;
  real cos3 = branch[1] * FN(sqrt)(1 - sin3 * sin3), down = cos3 * drop, reach = x * x + z * z;
  if (reach < (real)1e-12) reach = (real)1e-12;
  real cos2 = (along * x + down * z) / reach, sin2 = (down * x - along * z) / reach;

  real dx = wrist[0], dy = wrist[4], dz = wrist[8];
  turned(cos1, -sin1, &dx, &dy), turned(cos2, sin2, &dx, &dz);
  turned(cos3, -sin3, &dy, &dz), turned(cos4, sin4, &dx, &dz);
  real fx = cos4, fy = sin3 * sin4, fz = -cos3 * sin4;
  turned(cos2, -sin2, &fx, &fz), turned(cos1, sin1, &fx, &fy);
  real row[2];
  for (int i = 0; i < 2; i++)
    row[i] = wrist[1 + i] * fx + wrist[5 + i] * fy + wrist[9 + i] * fz;
  q[0] = pan, q[1] = FN(atan2)(sin2, cos2), q[2] = FN(atan2)(sin3, cos3);
  q[3] = FN(atan2)(sin4, cos4), q[4] = FN(atan2)(branch[2] * dy, -branch[2] * dz);
  q[5] = FN(atan2)(branch[2] * FN(sqrt)(dy * dy + dz * dz), dx);
  q[6] = FN(atan2)(branch[2] * row[0], branch[2] * row[1]);
  return within_limits(form, q);
}
