/* The first motion of a route of the base around what is seen: cgtorch.tabletop.world.routes. */
#pragma once
#include "tabletop.h"

#define VIAS 3
#define ROOM ((real)1.05)
#define LONGEST ((real)1.9)
#define AWAY ((real)0.05)
#define WORTH_TURNING ((real)0.001)
#define MOST_THINGS (1 + (MOST_PERCEPT - 7) / 4)
#define MOST_CORNERS (4 * MOST_THINGS)

/* Things in the percept, and the corners of a route; `there` if a corner exists. */
typedef struct {
  int count;
  Rectangle things[MOST_THINGS];
  vec x[MOST_CORNERS], y[MOST_CORNERS];
  vwhole there[MOST_CORNERS];
} Surroundings;

INLINE void surroundings(const vec *p, Layout layout, const Body *body, Surroundings *seen) {
  real rx = FN(fabs)(body->bx) + body->hx, ry = FN(fabs)(body->by) + body->hy;
  real reach = ROOM * FN(sqrt)(rx * rx + ry * ry);
  const int sx[4] = {1, 1, -1, -1}, sy[4] = {1, -1, -1, 1};
  seen->count = 1 + layout.boxes;
  for (int k = 0; k < seen->count; k++) {
    Rectangle *r = seen->things + k;
    *r = k ? box_rectangle(box_seen(p, layout, k - 1)) : table_seen(p, layout);
    for (int i = 0; i < 4; i++) {
      vec x, y;
      turn((real)sx[i] * (r->sx / 2 + reach), (real)sy[i] * (r->sy / 2 + reach), r->c, r->s, &x, &y);
      seen->x[4 * k + i] = r->x + x, seen->y[4 * k + i] = r->y + y;
      seen->there[4 * k + i] = (r->sx > 0) & (r->sy > 0);
    }
  }
}
/* The same in the frame after a turn. */
INLINE void turned_by(const Surroundings *seen, vec c, vec s, Surroundings *turned) {
  *turned = *seen;
  for (int k = 0; k < seen->count; k++) {
    const Rectangle *r = seen->things + k;
    Rectangle *t = turned->things + k;
    turn(r->x, r->y, c, -s, &t->x, &t->y);
    turn(r->c, r->s, c, -s, &t->c, &t->s);
  }
  for (int j = 0; j < 4 * seen->count; j++)
    turn(seen->x[j], seen->y[j], c, -s, turned->x + j, turned->y + j);
}
INLINE vwhole possible_from(const Surroundings *seen, vec x, vec y, const vec *u, const Body *body,
                            vwhole rows) {
  rows &= is_within(u, body);
  for (int k = 0; k < seen->count && bits_of(rows); k++) {
    Rectangle r = seen->things[k];
    r.x -= x, r.y -= y;
    rows = clear_of(u, &r, body, rows);
  }
  return rows;
}
INLINE vec length_of(const vec *u) { return vec_sqrt(u[0] * u[0] + u[1] * u[1]); }

/* The length of the shortest route past corners, infinite without one, for `rows`; and its first corner,
   where the base turns by `by`. */
INLINE vec shortest(const Surroundings *seen, const vec *u, vec by, const Body *body, vwhole rows,
                    vec *x, vec *y) {
  int corners = 4 * seen->count;
  vec length[MOST_CORNERS], next[MOST_CORNERS], ends[MOST_CORNERS], c, s, gx, gy;
  vwhole first[MOST_CORNERS], after[MOST_CORNERS], some = every(0);
  Surroundings turned;
  sine_cosine(by, &s, &c);
  turned_by(seen, c, s, &turned);
  turn(u[0], u[1], c, -s, &gx, &gy);
  for (int j = 0; j < corners; j++) {
    vec last[3] = {gx - turned.x[j], gy - turned.y[j], wrap(u[2] - by)};
    vwhole ended = possible_from(&turned, turned.x[j], turned.y[j], last, body, rows & seen->there[j]);
    ends[j] = select_vec(ended, length_of(last), vec_of(INFINITY));
    some |= ended;
  }
  vec best = vec_of(INFINITY);
  *x = *y = vec_of(0);
  rows &= some;
  if (!bits_of(rows)) return best;
  for (int j = 0; j < corners; j++) {
    vec to[3] = {seen->x[j], seen->y[j], by};
    vwhole outside = rows & seen->there[j] & (length_of(to) > AWAY);
    vwhole begun = possible_from(seen, vec_of(0), vec_of(0), to, body, outside);
    length[j] = select_vec(begun, length_of(to), vec_of(INFINITY));
    first[j] = every(j);
  }
  for (int round = 1; round < VIAS; round++) {
    for (int j = 0; j < corners; j++) {
      next[j] = length[j], after[j] = first[j];
      for (int i = 0; i < corners; i++) {
        vec on[3] = {turned.x[j] - turned.x[i], turned.y[j] - turned.y[i], vec_of(0)};
        vec total = length[i] + length_of(on);
        vwhole better = rows & seen->there[j] & (total < next[j]);
        if (!bits_of(better)) continue;
        better = possible_from(&turned, turned.x[i], turned.y[i], on, body, better);
        next[j] = select_vec(better, total, next[j]);
        after[j] = select_whole(better, first[i], after[j]);
      }
    }
    for (int j = 0; j < corners; j++) length[j] = next[j], first[j] = after[j];
  }
  vwhole corner = every(0);
  for (int j = 0; j < corners; j++) {
    vwhole better = length[j] + ends[j] < best;
    best = select_vec(better, length[j] + ends[j], best);
    corner = select_whole(better, first[j], corner);
  }
  for (int j = 0; j < corners; j++) {
    *x = select_vec(corner == j, seen->x[j], *x);
    *y = select_vec(corner == j, seen->y[j], *y);
  }
  return best;
}

/* Replaces the motions of `rows` by the first motions of routes; returns the rows with a route. */
INLINE vwhole around(const vec *p, Layout layout, const Body *body, vwhole rows, vec *u) {
  Surroundings seen;
  vec x, y, best = vec_of(INFINITY), wanted[3] = {u[0], u[1], u[2]};
  surroundings(p, layout, body, &seen);
  for (int turns = 0; turns < 2; turns++) {
    vec by = turns ? wanted[2] : vec_of(0);
    vec length = shortest(&seen, wanted, by, body, rows, &x, &y);
    vwhole shorter = rows & (length < best - WORTH_TURNING);
    best = select_vec(shorter, length, best);
    u[0] = select_vec(shorter, x, u[0]), u[1] = select_vec(shorter, y, u[1]);
    u[2] = select_vec(shorter, by, u[2]);
  }
  return rows & (best < INFINITY);
}

/* The first motions of routes to the goals of motions, which are the motions themselves if these are clear.
   */
APART void first_motion(const vec *p, Layout layout, const Body *base, vwhole rows, vec *u) {
  Body body = *base;
  body.farthest = INFINITY;
  vwhole found = motion_possible(p, u, layout, &body, rows), blocked = rows & ~found;
  if (bits_of(blocked)) found |= around(p, layout, &body, blocked, u);
  vec distance = length_of(u);
  vwhole too_long = found & (distance > LONGEST);
  for (int i = 0; i < 2; i++) u[i] = select_vec(too_long, u[i] * (LONGEST / distance), u[i]);
  u[2] = select_vec(too_long, vec_of(0), u[2]);
}
