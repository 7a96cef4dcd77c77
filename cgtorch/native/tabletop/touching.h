/* Whether an arm touches its table and body in a posture (cgtorch.tabletop.kinematics.touching). */
#pragma once
#include "tabletop/chain.h"

#define MOST_CAPSULES 256

typedef struct {
  const real *centre, *rotation, *half; /* (B or 1, N, 3), (B or 1, N, 3, 3), (B or 1, N, 3) */
  int64_t count, same;                  /* N; `same`: the boxes of one row are those of all */
} Boxes;

typedef struct {
  Chain chain;
  Boxes table, body;
  const real *q, *start, *end, *radius; /* (B, joints); (C, 3) and (C, 3) in frames; (C,) */
  const int64_t *frame;                 /* (C,) that capsules move with */
  const unsigned char *loose;           /* (C,) capsules that can touch the body */
  unsigned char *hit;                   /* (B,) */
  int64_t postures, capsules, bisections;
  double rounding;
} Arms;
static inline real clamped(real x, real half) { return x < -half ? -half : x > half ? half : x; }

/* From the nearest point of a box to one on a segment. */
static inline void outside(const real *a, const real *along, real at, const real *half, real *out) {
  for (int i = 0; i < 3; i++) {
    real x = FMA(at, along[i], a[i]);
    out[i] = x - clamped(x, half[i]);
  }
}

/* Squared distance of a segment and a box around the origin, by bisection on the slope. */
static real squared_distance(const real *a, const real *along, const real *half, int64_t bisections) {
  real low = 0, high = 1, away[3], least = INFINITY;
  for (int64_t i = 0; i < bisections; i++) {
    real middle = (low + high) / 2;
    outside(a, along, middle, half, away);
    if (dot(away, along) > 0) high = middle;
    else low = middle;
  }
  const real at[3] = {0, 1, (low + high) / 2};
  for (int i = 0; i < 3; i++) {
    outside(a, along, at[i], half, away);
    real here = dot(away, away);
    if (here < least) least = here;
  }
  return least;
}

static int touches(const Arms *arms, const Boxes *boxes, int64_t box, const real *start,
                   const real *end, real radius) {
  const real *half = boxes->half + box * 3, *turn = boxes->rotation + box * 9;
  const real *centre = boxes->centre + box * 3;
  real a[3], along[3], away = 0, length = 0;
  for (int i = 0; i < 3; i++) {
    a[i] = along[i] = 0;
    for (int j = 0; j < 3; j++) {
      a[i] = FMA(turn[j * 3 + i], start[j] - centre[j], a[i]);
      along[i] = FMA(turn[j * 3 + i], end[j] - start[j], along[i]);
    }
    length = FMA(along[i], along[i], length);
    real middle = a[i] + along[i] / 2, beyond = middle - clamped(middle, half[i]);
    away = FMA(beyond, beyond, away);
  }
  /* The sphere around a capsule reaches few boxes. */
  real reach = ((real)sqrt((double)length) / 2 + radius) * (real)(1 + arms->rounding);
  return away <= reach * reach &&
         squared_distance(a, along, half, arms->bisections) < radius * radius;
}

/* Whether any of a row's capsules that `which` has (all without it) touches any of its boxes. */
static int any_touches(const Arms *arms, const Boxes *boxes, int64_t row, const real *start,
                       const real *end, const unsigned char *which) {
  int64_t first = (boxes->same ? 0 : row) * boxes->count;
  for (int64_t box = first; box < first + boxes->count; box++)
    for (int64_t i = 0; i < arms->capsules; i++)
      if ((!which || which[i]) &&
          touches(arms, boxes, box, start + i * 3, end + i * 3, arms->radius[i]))
        return 1;
  return 0;
}

static int arm_touches(const Arms *a, int64_t row, const real *q) {
  real poses[MOST_FRAMES][12], starts[MOST_CAPSULES * 3], ends[MOST_CAPSULES * 3];
  poses_of(&a->chain, q, poses);
  for (int64_t i = 0; i < a->capsules; i++) {
    const real *pose = poses[a->frame[i]];
    placed(pose, a->start + i * 3, starts + i * 3);
    placed(pose, a->end + i * 3, ends + i * 3);
  }
  return any_touches(a, &a->table, row, starts, ends, NULL) ||
         any_touches(a, &a->body, row, starts, ends, a->loose);
}
