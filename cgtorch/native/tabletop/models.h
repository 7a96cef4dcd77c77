/* Γ and C for a vector of rows: cgtorch.tabletop.models.{transition,geometry,success}. */
#pragma once
#include "svm/rbf.h"
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

/* ---- Γ ---- */

/* Quantities of a percept in Γ before one of the two yaws is selected; (c, s1) and (c, s2) are their cosines
   and sines. */
typedef struct {
  vec cx, cy, ew, eh, c, s1, s2, sides[2];
} Scene;

INLINE vec length(vec x, vec y) { return vec_sqrt(vec_max(vec_of((real)1e-30), x * x + y * y)); }
INLINE void rigid(vec x, vec y, const vec *u, vec c, vec s, vec *mx, vec *my) {
  x -= u[0];
  y -= u[1];
  *mx = c * x + s * y;
  *my = c * y - s * x;
}
INLINE void turned_extents(vec c, vec s, const vec *sides, vec *w, vec *h) {
  c = vec_abs(c), s = vec_abs(s);
  *w = sides[0] * c + sides[1] * s;
  *h = sides[0] * s + sides[1] * c;
}
INLINE void loosely_turned(vec w, vec h, vec cos2, vec *tw, vec *th) {
  vec total = w + h, gap = (w - h) * cos2;
  *tw = (total + gap) / 2;
  *th = (total - gap) / 2;
}

INLINE Scene scene_of(const Gamma *g, Layout layout, const vec *p) {
  Scene at = {.cx = (p[0] + p[1]) / 2, .cy = (p[2] + p[3]) / 2, .ew = p[1] - p[0], .eh = p[3] - p[2]};
  if (layout.side) {
    Rectangle table = table_seen(p, layout);
    at.c = table.c, at.s1 = at.s2 = table.s;
    at.sides[0] = table.sx, at.sides[1] = table.sy;
    return at;
  }
  real a2 = g->sides[0] * g->sides[0], b2 = g->sides[1] * g->sides[1];
  real gap = b2 - a2, twice = 2 * (g->sides[0] * g->sides[1]);
  vec w2 = at.ew * at.ew, h2 = at.eh * at.eh, y = positive((w2 + h2 - a2 - b2) / twice);
  half_angle((h2 - w2) / (gap < (real)1e-9 ? (real)1e-9 : gap), y, &at.c, &at.s1);
  at.s1 = select_vec((p[4] - at.cx) * (p[5] - at.cy) < 0, -at.s1, at.s1);
  at.s2 = -at.s1;
  at.sides[0] = vec_of(g->sides[0]), at.sides[1] = vec_of(g->sides[1]);
  return at;
}
INLINE void gamma_features(const Gamma *g, const Scene *at, const vec *p, vec *x) {
  vec ox = p[4] - at->cx, oy = p[5] - at->cy;
  x[0] = at->c * ox + at->s1 * oy, x[1] = at->c * oy - at->s1 * ox;
  x[2] = at->c * ox + at->s2 * oy, x[3] = at->c * oy - at->s2 * ox;
  for (int i = 0; i < 4; i++) x[i] = (vec_abs(x[i]) - g->mean[i]) / g->scale[i];
}
/* The box around the table after a motion, given the machine's output `value`, which selects a yaw. */
INLINE void table_after(const Gamma *g, const Scene *at, const vec *u, vec c, vec s, vec cos2,
                        vec value, vec *after) {
  vec w1, h1, w2, h2, lw, lh, mx, my, weight, unused;
  turned_extents(at->c * c + at->s1 * s, at->s1 * c - at->c * s, at->sides, &w1, &h1);
  turned_extents(at->c * c + at->s2 * s, at->s2 * c - at->c * s, at->sides, &w2, &h2);
  value = vec_max(vec_of(-1), vec_min(vec_of(1), value));
  sine_cosine((real)(PI / 2) * value, &weight, &unused);
  weight /= 2;
  vec w = (w1 + w2) / 2 + weight * (w1 - w2), h = (h1 + h2) / 2 + weight * (h1 - h2);
  loosely_turned(at->ew, at->eh, cos2, &lw, &lh);
  w = (lw + g->trust * (w - lw)) / 2;
  h = (lh + g->trust * (h - lh)) / 2;
  rigid(at->cx, at->cy, u, c, s, &mx, &my);
  after[0] = mx - w, after[1] = mx + w, after[2] = my - h, after[3] = my + h;
}
INLINE void boxes_after(Layout layout, const vec *p, const vec *u, vec c, vec s, vec cos2,
                        vec *after) {
  for (int k = 0; k < layout.boxes; k++) {
    const vec *box = box_seen(p, layout, k);
    vec mx, my, w, h, *out = after + (box - p);
    rigid((box[0] + box[1]) / 2, (box[2] + box[3]) / 2, u, c, s, &mx, &my);
    loosely_turned(box[1] - box[0], box[3] - box[2], cos2, &w, &h);
    out[0] = mx - w / 2, out[1] = mx + w / 2, out[2] = my - h / 2, out[3] = my + h / 2;
    for (int i = 0; i < 4; i++) out[i] = select_vec(there(box), out[i], vec_of(0));
  }
}
INLINE vec novelty_of(const Gamma *g, const Scene *at, const vec *p, const vec *u, vec distance) {
  vec w, h, over = vec_of(0);
  turned_extents(at->c, at->s1, at->sides, &w, &h);
  vec extreme[4] = {length(p[4], p[5]), length(u[0], u[1]), vec_abs(u[2]),
                    length(at->ew - w, at->eh - h)};
  for (int i = 0; i < 4; i++) over += positive(extreme[i] / g->most[i] - 1);
  return 1 - exp2_vec(-(distance * g->per_distance / g->reach + over / (real)0.1));
}

/* The next percepts and novelties of the rows in `bits`, `predict_with_novelty`; others are undefined. */
APART void gamma_vec(const Gamma *g, Layout layout, const vec *p, const vec *u, uint32_t bits,
                     vec *after, vec *novelty) {
  Scene at = scene_of(g, layout, p);
  vec x[4], value, distance, c, s;
  gamma_features(g, &at, p, x);
  machine_lanes(&g->machine, x, bits, 4, &value, &distance);
  sine_cosine(u[2], &s, &c);
  vec cos2 = c * c - s * s, sin2 = 2 * c * s;
  table_after(g, &at, u, c, s, cos2, value, after);
  rigid(p[4], p[5], u, c, s, after + 4, after + 5);
  after[6] = p[6];
  if (layout.side) {
    after[7] = cos2 * p[7] + sin2 * p[8];
    after[8] = cos2 * p[8] - sin2 * p[7];
  }
  boxes_after(layout, p, u, c, s, cos2, after);
  *novelty = novelty_of(g, &at, p, u, distance);
}

/* ---- C ---- */

#define NEAR ((real)0.5)
#define STRETCH 4
#define TURN 2
#define RISE 3

/* NEAR tanh(x / NEAR). */
INLINE vec saturated(vec x) { return NEAR * (2 * sigmoid_vec(x * (2 / NEAR)) - 1); }

/* The two edges in front of which the robot is farthest out, `success.edges`. */
INLINE void edges(const Rectangle *table, const vec *placed, vec *out) {
  vec c = table->c, s = table->s, x = placed[0] - table->x, y = placed[1] - table->y;
  vec nx[4] = {c, -c, -s, s}, ny[4] = {s, -s, c, -c};
  vec one = vec_of(-INFINITY), two = one, inset1 = one, inset2 = one, nx1 = one, ny1 = one;
  for (int i = 0; i < 4; i++) {
    vec half = (i < 2 ? table->sx : table->sy) / 2;
    vec ahead = -(nx[i] * table->x + ny[i] * table->y) - half;
    vec inset = half - (nx[i] * x + ny[i] * y);
    vwhole first = ~(ahead <= one), second = ~(ahead <= two);
    two = select_vec(first, one, select_vec(second, ahead, two));
    inset2 = select_vec(first, inset1, select_vec(second, inset, inset2));
    one = select_vec(first, ahead, one);
    inset1 = select_vec(first, inset, inset1);
    nx1 = select_vec(first, nx[i], nx1), ny1 = select_vec(first, ny[i], ny1);
  }
  out[0] = saturated(one), out[1] = saturated(two);
  out[2] = inset1, out[3] = inset2;
  out[4] = NEAR * nx1, out[5] = NEAR * ny1;
}

INLINE void features_of_c(Layout layout, const vec *p, vec *x) {
  vec far = vec_max(vec_of((real)1e-6), vec_sqrt(p[4] * p[4] + p[5] * p[5]));
  vec *polar = layout.side ? x : x + 4;
  polar[0] = STRETCH * far, polar[1] = TURN * p[4] / far, polar[2] = TURN * p[5] / far;
  polar[3] = RISE * p[6];
  if (layout.side) {
    Rectangle table = table_seen(p, layout);
    edges(&table, p + 4, x + 4);
  } else {
    for (int i = 0; i < 4; i++) x[i] = saturated(p[i]);
  }
}

/* The probability of success of the rows in `bits`, `SuccessClassifier.forward`. */
APART vec success_vec(const Classifier *f, Layout layout, const vec *p, uint32_t bits) {
  vec x[MOST_FEATURES], value, distance;
  features_of_c(layout, p, x);
  for (int i = 0; i < f->machine.d; i++) x[i] = (x[i] - f->mean[i]) / f->scale[i];
  switch (f->machine.d) { /* with the number of features known, all of it stays in registers */
  case 7: machine_lanes(&f->machine, x, bits, 7, &value, &distance); break;
  case 8: machine_lanes(&f->machine, x, bits, 8, &value, &distance); break;
  case 10: machine_lanes(&f->machine, x, bits, 10, &value, &distance); break;
  default: machine_lanes(&f->machine, x, bits, (int)f->machine.d, &value, &distance);
  }
  return sigmoid_vec(-(f->slope * value + f->offset));
}
