/* Γ and C, one row at a time: cgtorch.models.{transition,geometry,success,grasp_features}. */
#ifndef CGTORCH_MODELS_H
#define CGTORCH_MODELS_H
#include "rbf.h"
#include "tabletop.h"

typedef struct {
  Machine machine;
  real mean[4], scale[4], sides[2], most[4], trust, reach, per_distance; /* 1 / (gamma log2 e) */
} Gamma;

typedef struct {
  Machine machine;
  const real *mean, *scale; /* (machine.d,) */
  real slope, offset;
} Classifier;

INLINE real length(real x, real y) {
  real square = x * x + y * y;
  return FN(sqrt)(square < (real)1e-30 ? (real)1e-30 : square);
}
INLINE real sigmoid(real x) { return 1 / (1 + FN(exp)(-x > 80 ? 80 : -x)); }
INLINE void rigid(real x, real y, const real *u, real c, real s, real *mx, real *my) {
  x -= u[0];
  y -= u[1];
  *mx = c * x + s * y;
  *my = c * y - s * x;
}
INLINE void turned_extents(real c, real s, const real *sides, real *w, real *h) {
  c = absolute(c), s = absolute(s);
  *w = sides[0] * c + sides[1] * s;
  *h = sides[0] * s + sides[1] * c;
}
/* Cosine and sine of half the angle of (x, y), y >= 0, whichever is the larger one first. */
INLINE void half_angle(real x, real y, real *c, real *s) {
  real size = FN(sqrt)(x * x + y * y), share = size > 0 ? x / size : 1;
  real larger = FN(sqrt)((1 + absolute(share)) / 2);
  real smaller = size > 0 ? y / (2 * size * larger) : 0;
  *c = share >= 0 ? larger : smaller;
  *s = share >= 0 ? smaller : larger;
}
INLINE void loosely_turned(real w, real h, real cos2, real *tw, real *th) {
  real total = w + h, gap = (w - h) * cos2;
  *tw = (total + gap) / 2;
  *th = (total - gap) / 2;
}

/* The next percept and how novel the motion is, `predict_with_novelty`. */
INLINE void gamma_row(const Gamma *g, Layout layout, const real *p, const real *u, real *after,
                      real *novelty) {
  real cx = (p[0] + p[1]) / 2, cy = (p[2] + p[3]) / 2, ew = p[1] - p[0], eh = p[3] - p[2];
  real ox = p[4] - cx, oy = p[5] - cy, c1, s1, s2, sides[2]; /* of the two yaws, whose cosine is one */
  if (layout.side) {
    Rectangle table = table_seen(p, layout);
    c1 = FN(cos)(table.yaw), s1 = s2 = FN(sin)(table.yaw);
    sides[0] = table.sx, sides[1] = table.sy;
  } else {
    real a2 = g->sides[0] * g->sides[0], b2 = g->sides[1] * g->sides[1], w2 = ew * ew, h2 = eh * eh;
    real gap = b2 - a2, twice = 2 * (g->sides[0] * g->sides[1]);
    real y = positive((w2 + h2 - a2 - b2) / twice);
    half_angle((h2 - w2) / (gap < (real)1e-9 ? (real)1e-9 : gap), y, &c1, &s1);
    s1 = ox * oy < 0 ? -s1 : s1;
    s2 = -s1;
    sides[0] = g->sides[0], sides[1] = g->sides[1];
  }
  real at[4] = {absolute(c1 * ox + s1 * oy), absolute(c1 * oy - s1 * ox),
                absolute(c1 * ox + s2 * oy), absolute(c1 * oy - s2 * ox)};
  for (int i = 0; i < 4; i++) at[i] = (at[i] - g->mean[i]) / g->scale[i];
  real value, distance;
  machine_rows(&g->machine, at, 1, 1, 4, &value, &distance);

  real c = FN(cos)(u[2]), s = FN(sin)(u[2]), cos2 = c * c - s * s, sin2 = 2 * c * s;
  real w1, h1, wt, ht, lw, lh, mx, my;
  turned_extents(c1 * c + s1 * s, s1 * c - c1 * s, sides, &w1, &h1);
  turned_extents(c1 * c + s2 * s, s2 * c - c1 * s, sides, &wt, &ht);
  real bounded = value < -1 ? -1 : value > 1 ? 1 : value;
  real weight = FN(sin)((real)(PI / 2) * bounded) / 2;
  real w = (w1 + wt) / 2 + weight * (w1 - wt), h = (h1 + ht) / 2 + weight * (h1 - ht);
  loosely_turned(ew, eh, cos2, &lw, &lh);
  w = (lw + g->trust * (w - lw)) / 2;
  h = (lh + g->trust * (h - lh)) / 2;
  rigid(cx, cy, u, c, s, &mx, &my);
  after[0] = mx - w, after[1] = mx + w, after[2] = my - h, after[3] = my + h;
  rigid(p[4], p[5], u, c, s, after + 4, after + 5);
  after[6] = p[6];
  if (layout.side) {
    after[7] = cos2 * p[7] + sin2 * p[8];
    after[8] = cos2 * p[8] - sin2 * p[7];
  }
  for (int k = 0; k < layout.boxes; k++) {
    const real *box = box_seen(p, layout, k);
    real *out = after + (box - p);
    if (there(box)) {
      rigid((box[0] + box[1]) / 2, (box[2] + box[3]) / 2, u, c, s, &mx, &my);
      loosely_turned(box[1] - box[0], box[3] - box[2], cos2, &lw, &lh);
      out[0] = mx - lw / 2, out[1] = mx + lw / 2, out[2] = my - lh / 2, out[3] = my + lh / 2;
    } else {
      memset(out, 0, 4 * sizeof(real));
    }
  }
  turned_extents(c1, s1, sides, &w1, &h1);
  real extreme[4] = {length(p[4], p[5]), length(u[0], u[1]), absolute(u[2]),
                     length(ew - w1, eh - h1)};
  real over = 0;
  for (int i = 0; i < 4; i++) over += positive(extreme[i] / g->most[i] - 1);
  real exponent = distance * g->per_distance / g->reach + over / (real)0.1;
  *novelty = 1 - FN(exp)(-(real)0.69314718055994530942 * exponent);
}

/* ---- C ---- */

#define NEAR ((real)0.5)
#define STRETCH 4
#define TURN 2
#define RISE 3

/* NEAR tanh(x / NEAR) of a few numbers, in place. */
INLINE void saturate(real *x, int count) {
  for (int i = 0; i < count; i++) x[i] *= 2 / NEAR;
  sigmoids(x, count);
  for (int i = 0; i < count; i++) x[i] = NEAR * (2 * x[i] - 1);
}

/* How the two edges lie that the robot stands farthest in front of, `grasp_features.edges`. */
INLINE void edges(Rectangle table, const real *placed, real *out) {
  real c = FN(cos)(table.yaw), s = FN(sin)(table.yaw), x = placed[0] - table.x, y = placed[1] - table.y;
  real nx[4] = {c, -c, -s, s}, ny[4] = {s, -s, c, -c}, ahead[4], inset[4];
  for (int i = 0; i < 4; i++) {
    real half = (i < 2 ? table.sx : table.sy) / 2;
    ahead[i] = -(nx[i] * table.x + ny[i] * table.y) - half;
    inset[i] = half - (nx[i] * x + ny[i] * y);
  }
  int one = 0, two = -1;
  for (int i = 1; i < 4; i++)
    if (ahead[i] > ahead[one]) one = i;
  for (int i = 0; i < 4; i++)
    if (i != one && (two < 0 || ahead[i] > ahead[two])) two = i;
  out[0] = ahead[one], out[1] = ahead[two];
  saturate(out, 2);
  out[2] = inset[one], out[3] = inset[two];
  out[4] = NEAR * nx[one], out[5] = NEAR * ny[one];
}

/* The probability that a grasp succeeds, `SuccessClassifier.forward`. */
INLINE real success_row(const Classifier *f, Layout layout, const real *p) {
  real at[MOST_FEATURES], value, distance;
  if (layout.boxes > 1) { /* percepts of other lengths are learnt from as they are */
    for (int i = 0; i < layout.size; i++) at[i] = p[i];
  } else {
    real far = FN(sqrt)(p[4] * p[4] + p[5] * p[5]);
    if (far < (real)1e-6) far = (real)1e-6;
    real *polar = layout.side ? at : at + 4;
    polar[0] = STRETCH * far, polar[1] = TURN * p[4] / far, polar[2] = TURN * p[5] / far;
    polar[3] = RISE * p[6];
    if (layout.side) edges(table_seen(p, layout), p + 4, at + 4);
    else memcpy(at, p, 4 * sizeof(real)), saturate(at, 4);
  }
  for (int i = 0; i < f->machine.d; i++) at[i] = (at[i] - f->mean[i]) / f->scale[i];
  switch (f->machine.d) { /* with the number of features known, all of it stays in registers */
  case 7: machine_rows(&f->machine, at, 1, 1, 7, &value, &distance); break;
  case 8: machine_rows(&f->machine, at, 1, 1, 8, &value, &distance); break;
  case 10: machine_rows(&f->machine, at, 1, 1, 10, &value, &distance); break;
  default: machine_rows(&f->machine, at, 1, 1, (int)f->machine.d, &value, &distance);
  }
  return sigmoid(-(f->slope * value + f->offset));
}
#endif
