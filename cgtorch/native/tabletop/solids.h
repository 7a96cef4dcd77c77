/* Solids, each the sum of a box, a disc about z and a ball, and their distances by the
   Gilbert-Johnson-Keerthi algorithm ("A fast procedure for computing the distance between complex objects in
   three-dimensional space", 1988), which needs only the point of a solid that is farthest in a direction. A
   cylinder is a half height and a disc, a capsule a half height and a ball. */
#pragma once
#include "tabletop/arm.h"

#define MOST_ROUNDS 40
#define TOLERANCE (real)1e-5 /* m */
#define TOUCHING (real)1e-12 /* m^2: the origin lies in the difference of two solids */

typedef struct {
  real pose[12];
  const real *size; /* (5,) half sides of the box, radius of the disc, radius of the ball */
} Solid;

static inline real size_along(real size, real along) { return along < 0 ? -size : size; }

/* The point of a solid without its ball that is farthest in a direction. */
static inline void farthest(const Solid *s, const real *way, real *out) {
  const real *p = s->pose, *size = s->size;
  real local[3], at[3];
  for (int i = 0; i < 3; i++) local[i] = p[i] * way[0] + p[4 + i] * way[1] + p[8 + i] * way[2];
  for (int i = 0; i < 3; i++) at[i] = size_along(size[i], local[i]);
  real flat = local[0] * local[0] + local[1] * local[1];
  if (size[3] > 0 && flat > 0) {
    real scale = size[3] / FN(sqrt)(flat);
    at[0] += scale * local[0], at[1] += scale * local[1];
  }
  placed(p, at, out);
}

/* The point nearest to the origin of a segment, a triangle or a tetrahedron, whose corners become those that
   span it; returns their number (Ericson, "Real-time collision detection", 2005, 5.1). */
static inline void copied(const real *from, real *to) {
  for (int i = 0; i < 3; i++) to[i] = from[i];
}

static int of_segment(real corner[4][3], real *out) {
  real along[3];
  minus(corner[1], corner[0], along);
  real share = -dot(corner[0], along), length = dot(along, along);
  if (share <= 0) return copied(corner[0], out), 1;
  if (share >= length) return copied(corner[1], corner[0]), copied(corner[0], out), 1;
  for (int i = 0; i < 3; i++) out[i] = corner[0][i] + share / length * along[i];
  return 2;
}

static int of_edge(real corner[4][3], int i, int j, real *out) {
  real ends[4][3];
  copied(corner[i], ends[0]), copied(corner[j], ends[1]);
  int count = of_segment(ends, out);
  copied(ends[0], corner[0]), copied(ends[1], corner[1]);
  return count;
}

static int of_triangle(real corner[4][3], real *out) {
  const real *a = corner[0], *b = corner[1], *c = corner[2];
  real ab[3], ac[3];
  minus(b, a, ab), minus(c, a, ac);
  real d1 = -dot(ab, a), d2 = -dot(ac, a), d3 = -dot(ab, b), d4 = -dot(ac, b), d5 = -dot(ab, c),
       d6 = -dot(ac, c);
  if (d1 <= 0 && d2 <= 0) return copied(a, out), 1;
  if (d3 >= 0 && d4 <= d3) return copied(b, corner[0]), copied(corner[0], out), 1;
  if (d6 >= 0 && d5 <= d6) return copied(c, corner[0]), copied(corner[0], out), 1;
  real vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return of_edge(corner, 0, 1, out);
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return of_edge(corner, 0, 2, out);
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return of_edge(corner, 1, 2, out);
  real all = va + vb + vc;
  for (int i = 0; i < 3; i++) out[i] = a[i] + (vb * ab[i] + vc * ac[i]) / all;
  return 3;
}

static int of_tetrahedron(real corner[4][3], real *out) {
  static const int FACES[4][4] = {{0, 1, 2, 3}, {0, 1, 3, 2}, {0, 2, 3, 1}, {1, 2, 3, 0}};
  real least = INFINITY, kept[4][3] = {{0}};
  int count = 4;
  for (int f = 0; f < 4; f++) {
    const int *face = FACES[f];
    real ab[3], ac[3], normal[3], ad[3], corners[4][3], here[3];
    const real *a = corner[face[0]];
    minus(corner[face[1]], a, ab), minus(corner[face[2]], a, ac), minus(corner[face[3]], a, ad);
    normal[0] = ab[1] * ac[2] - ab[2] * ac[1];
    normal[1] = ab[2] * ac[0] - ab[0] * ac[2];
    normal[2] = ab[0] * ac[1] - ab[1] * ac[0];
    /* The origin lies beyond the face, or all four corners in one plane. */
    real origin = -dot(a, normal), other = dot(ad, normal);
    if (origin * other > 0) continue;
    for (int i = 0; i < 3; i++) copied(corner[face[i]], corners[i]);
    int found = of_triangle(corners, here);
    real away = dot(here, here);
    if (away < least) {
      least = away, count = found, copied(here, out);
      for (int i = 0; i < 3; i++) copied(corners[i], kept[i]);
    }
  }
  if (count == 4) {
    out[0] = out[1] = out[2] = 0;
    return 4;
  }
  for (int i = 0; i < 3; i++) copied(kept[i], corner[i]);
  return count;
}

/* A lower bound of the distance of two solids, m, exact to TOLERANCE; or any number on the same side of
   `near` and of `far`, as only these comparisons count. */
static real distance_of(const Solid *a, const Solid *b, real near, real far) {
  real corner[4][3], away[3], least = -INFINITY, balls = a->size[4] + b->size[4];
  for (int i = 0; i < 3; i++) away[i] = a->pose[i * 4 + 3] - b->pose[i * 4 + 3];
  int count = 0;
  for (int round = 0; round < MOST_ROUNDS; round++) {
    real one[3], other[3], back[3], new[3], square = dot(away, away);
    if (square < TOUCHING) return -balls;
    for (int i = 0; i < 3; i++) back[i] = -away[i];
    farthest(a, back, one), farthest(b, away, other), minus(one, other, new);
    real length = FN(sqrt)(square), bound = dot(away, new) / length;
    if (bound > least) least = bound;
    if (least - balls >= far) return least - balls;
    if (count && (length - balls < near || length - least < TOLERANCE ||
                  (least - balls >= near && length - balls < far)))
      break;
    copied(new, corner[count++]);
    switch (count) {
    case 1: copied(new, away); break;
    case 2: count = of_segment(corner, away); break;
    case 3: count = of_triangle(corner, away); break;
    default: count = of_tetrahedron(corner, away);
    }
    if (count == 4) return -balls;
  }
  return least - balls;
}
