/* Whether capsules touch boxes (cgtorch.kinematics.collision), posture after posture. */
#include "parallel.h"
#include <math.h>

typedef REAL real;

typedef struct {
  const real *start, *end, *radius;        /* (B, C, 3), (B, C, 3), (C,) */
  const real *centre, *rotation, *half;    /* (B or 1, N, 3), (B or 1, N, 3, 3), (B or 1, N, 3) */
  int64_t postures, capsules, boxes, same; /* `same`: the boxes of one row are those of all */
  int64_t bisections;
  double rounding;
  unsigned char *hit; /* (B,) */
} Collision;

static inline real dot(const real *a, const real *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline real clamped(real x, real half) { return x < -half ? -half : x > half ? half : x; }

/* From the nearest point of a box to one on a segment. */
static inline void outside(const real *a, const real *along, real at, const real *half, real *out) {
  for (int i = 0; i < 3; i++) {
    real x = a[i] + at * along[i];
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

static int touches(const Collision *c, int64_t row, int64_t capsule, int64_t box) {
  const real *start = c->start + (row * c->capsules + capsule) * 3;
  const real *end = c->end + (row * c->capsules + capsule) * 3;
  int64_t which = (c->same ? 0 : row) * c->boxes + box;
  const real *half = c->half + which * 3, *turn = c->rotation + which * 9;
  const real *centre = c->centre + which * 3;
  real radius = c->radius[capsule], a[3], along[3], away = 0, length = 0;
  for (int i = 0; i < 3; i++) {
    a[i] = along[i] = 0;
    for (int j = 0; j < 3; j++) {
      a[i] += turn[j * 3 + i] * (start[j] - centre[j]);
      along[i] += turn[j * 3 + i] * (end[j] - start[j]);
    }
    length += along[i] * along[i];
    real middle = a[i] + along[i] / 2, beyond = middle - clamped(middle, half[i]);
    away += beyond * beyond;
  }
  /* The sphere around a capsule reaches few boxes. */
  real reach = ((real)sqrt((double)length) / 2 + radius) * (real)(1 + c->rounding);
  return away <= reach * reach && squared_distance(a, along, half, c->bisections) < radius * radius;
}

static void some_postures(void *what, int64_t begin, int64_t end) {
  const Collision *c = what;
  for (int64_t row = begin; row < end; row++) {
    int hit = 0;
    for (int64_t box = 0; box < c->boxes && !hit; box++)
      for (int64_t capsule = 0; capsule < c->capsules && !hit; capsule++)
        hit = touches(c, row, capsule, box);
    c->hit[row] = (unsigned char)hit;
  }
}

int collide(Collision *c, int64_t threads) {
  in_parallel(some_postures, c, c->postures, 256, threads);
  return 0;
}
