/* Whether an arm is clear of everything on its way, also between waypoints. A way is halved until each half
   is known to be clear. Two solids need no further test if, in the middle of a part, they are too far apart
   for the joints to bring them together before its ends (Schwarzer, Saha & Latombe, "Adaptive dynamic
   collision checking for single and multiple articulated robots in complex environments", 2005). */
#pragma once
#include "library.h"
#include "tabletop/solids.h"

#define MOST_JOINTS 16
#define MOST_SOLIDS 256
#define MOST_PAIRS 16384
#define MOST_WAYPOINTS 128
#define MOST_HALVINGS 24

enum { TABLE, OBJECT, HELD, OWN }; /* the first solids; from OWN on those of the arm and of others */

typedef struct {
  Chain chain;
  const real *pose, *size, *radius; /* (S, 3, 4), (S, 5), (S,) of a ball about the middle of each */
  const int64_t *frame;             /* (S,) of the chain that a solid moves with, -1 if it is still */
  const int64_t *pairs;             /* (P, 3) two solids, the first moves; bits of kinds of ways */
  const real *reach;                /* (P, joints) how much nearer a unit of a joint brings them, m */
  int64_t solids, count;            /* S, P */
  double margin, resolution;        /* m to keep; m that solids may come nearer unseen */
  double coarse;                    /* m: what may come nearer is measured in the halves only */
} Scene;

typedef struct {
  Scene scene;
  const real *table, *size, *object, *held; /* (K, 3, 4), (K, 5), (K, 3, 4), (K, 3, 4) of each way */
  const int64_t *kind;                      /* (K,) bit of each way */
  const real *q;                            /* (K, waypoints, joints) */
  unsigned char *clear;                     /* (K,) */
  int64_t ways, waypoints;
} Ways;

/* A way in its scene: waypoints and how far each joint has gone until there. */
typedef struct {
  const Scene *scene;
  const real *q;
  Solid solids[MOST_SOLIDS];
  real gone[MOST_WAYPOINTS][MOST_JOINTS];
  int64_t waypoints;
  int32_t todo[MOST_PAIRS * (MOST_HALVINGS + 2)]; /* pairs to look at, those of halves at the end */
} Way;

static void placed_in_scene(const Ways *ways, int64_t row, Way *way) {
  const Scene *scene = way->scene = &ways->scene;
  for (int64_t i = 0; i < scene->solids; i++) {
    const real *pose = scene->pose + i * 12;
    way->solids[i].size = i == TABLE ? ways->size + row * 5 : scene->size + i * 5;
    if (i == TABLE) pose = ways->table + row * 12;
    if (i == OBJECT) pose = ways->object + row * 12;
    memcpy(way->solids[i].pose, pose, sizeof way->solids[i].pose);
  }
}

/* Where the joints are at a place of the way, or how far they have gone. */
static inline void between(const real *rows, int64_t width, int64_t joints, int64_t waypoints, real at,
                           real *out) {
  int64_t first = (int64_t)at;
  if (first > waypoints - 2) first = waypoints - 2;
  if (first < 0) first = 0;
  const real *a = rows + first * width, *b = waypoints > 1 ? a + width : a;
  for (int64_t j = 0; j < joints; j++) out[j] = a[j] + (at - (real)first) * (b[j] - a[j]);
}

/* Whether the ball around a solid is at least so far from the box around another. */
static inline int ball_apart(const Solid *ball, real radius, const Solid *box, real gap) {
  const real *p = box->pose, *size = box->size;
  real away[3], square = 0;
  gap += radius + size[4];
  for (int i = 0; i < 3; i++) away[i] = ball->pose[i * 4 + 3] - p[i * 4 + 3];
  for (int i = 0; i < 3; i++) {
    real x = FN(fabs)(p[i] * away[0] + p[4 + i] * away[1] + p[8 + i] * away[2]) - size[i] -
             (i < 2 ? size[3] : 0);
    x = x > 0 ? x : 0, square += x * x;
  }
  return square >= gap * gap;
}

static void arm_placed(Way *way, const real *held, real at) {
  const Scene *scene = way->scene;
  real q[MOST_JOINTS], poses[MOST_FRAMES][12];
  between(way->q, scene->chain.joints, scene->chain.joints, way->waypoints, at, q);
  poses_of(&scene->chain, q, poses);
  for (int64_t i = HELD; i < scene->solids; i++)
    if (scene->frame[i] >= 0)
      product(poses[scene->frame[i]], i == HELD ? held : scene->pose + i * 12, way->solids[i].pose);
}

/* Whether pairs stay apart from a place of the way to another. */
static int clear_between(Way *way, const real *held, real begin, real end, const int32_t *pairs,
                         int64_t count, int32_t *kept, int halvings) {
  const Scene *scene = way->scene;
  int64_t joints = scene->chain.joints, left = 0;
  int moves = 0;
  real at = (begin + end) / 2, from[MOST_JOINTS], here[MOST_JOINTS], to[MOST_JOINTS];
  arm_placed(way, held, at);
  between(way->gone[0], MOST_JOINTS, joints, way->waypoints, begin, from);
  between(way->gone[0], MOST_JOINTS, joints, way->waypoints, at, here);
  between(way->gone[0], MOST_JOINTS, joints, way->waypoints, end, to);
  for (int64_t j = 0; j < joints; j++) {
    real before = here[j] - from[j], after = to[j] - here[j];
    here[j] = before > after ? before : after;
    moves |= here[j] > 0;
  }
  for (int64_t k = 0; k < count; k++) {
    const int64_t *pair = scene->pairs + pairs[k] * 3;
    const Solid *a = way->solids + pair[0], *b = way->solids + pair[1];
    const real *reach = scene->reach + pairs[k] * joints;
    real nearer = 0, margin = (real)scene->margin;
    for (int64_t j = 0; moves && j < joints; j++) nearer += reach[j] * here[j];
    if (ball_apart(a, scene->radius[pair[0]], b, margin + nearer) ||
        (pair[1] != TABLE && ball_apart(b, scene->radius[pair[1]], a, margin + nearer)))
      continue;
    if (nearer > (real)scene->coarse) {
      kept[left++] = pairs[k];
      continue;
    }
    real distance = distance_of(a, b, margin, margin + nearer);
    if (distance < margin) return 0;
    if (distance < margin + nearer && nearer > (real)scene->resolution) kept[left++] = pairs[k];
  }
  if (!left || halvings == MOST_HALVINGS) return 1;
  return clear_between(way, held, begin, at, kept, left, kept + left, halvings + 1) &&
         clear_between(way, held, at, end, kept, left, kept + left, halvings + 1);
}

/* Whether the way through waypoints (W, joints) is clear; `placed_in_scene` comes first. */
static int is_clear(Way *way, int64_t kind, const real *held, const real *q, int64_t waypoints) {
  const Scene *scene = way->scene;
  int64_t joints = scene->chain.joints, count = 0;
  way->q = q, way->waypoints = waypoints;
  for (int64_t j = 0; j < joints; j++) way->gone[0][j] = 0;
  for (int64_t w = 1; w < waypoints; w++)
    for (int64_t j = 0; j < joints; j++)
      way->gone[w][j] = way->gone[w - 1][j] + FN(fabs)(q[w * joints + j] - q[(w - 1) * joints + j]);
  for (int64_t k = 0; k < scene->count; k++)
    if (scene->pairs[k * 3 + 2] & kind) way->todo[count++] = (int32_t)k;
  return clear_between(way, held, 0, (real)(waypoints - 1), way->todo, count, way->todo + count, 0);
}
