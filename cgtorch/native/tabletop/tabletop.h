/* The tabletop as percepts show it, a vector of rows at once: cgtorch.tabletop.world.{percepts,clear_motion}
   and cgtorch.tabletop.edge_networks. */
#pragma once
#include "angles.h"
#include "engine/program.h"

#define TURN_STEPS 12 /* of 15 degrees */

/* From a percept's length: whether a side of the table is seen, and the number of obstacles. */
typedef struct {
  int size, side, boxes;
} Layout;

INLINE Layout layout_of(int64_t size) {
  int side = (size - 7) % 4 != 0;
  return MAKE(Layout){(int)size, side, (int)(size - 7 - 2 * side) / 4};
}

/* The columns of `rows` rows of `size`, WIDTH at most, as vectors; the first row fills up. */
INLINE void into_columns(const real *x, int64_t rows, int64_t stride, int size, vec *columns) {
  for (int j = 0; j < size; j++)
    for (int i = 0; i < WIDTH; i++) columns[j][i] = x[(i < rows ? i : 0) * stride + j];
}
INLINE void into_rows(const vec *columns, int64_t rows, int size, real *x) {
  for (int64_t i = 0; i < rows; i++)
    for (int j = 0; j < size; j++) x[i * size + j] = columns[j][i];
}

typedef struct {
  vec x, y, c, s, sx, sy; /* centre, cosine and sine of the yaw, sides */
} Rectangle;

INLINE vec positive(vec x) { return vec_max(vec_of(0), x); }
INLINE void turn(vec x, vec y, vec c, vec s, vec *tx, vec *ty) {
  *tx = c * x - s * y;
  *ty = s * x + c * y;
}
INLINE Rectangle box_rectangle(const vec *box) {
  return MAKE(Rectangle){(box[0] + box[1]) / 2, (box[2] + box[3]) / 2, vec_of(1), vec_of(0), box[1] - box[0],
                     box[3] - box[2]};
}
INLINE const vec *box_seen(const vec *p, Layout layout, int k) {
  return p + 7 + 2 * layout.side + 4 * k;
}
INLINE vwhole there(const vec *box) {
  return (box[0] != 0) | (box[1] != 0) | (box[2] != 0) | (box[3] != 0);
}
INLINE Rectangle table_seen(const vec *p, Layout layout) {
  Rectangle table = box_rectangle(p);
  if (!layout.side) return table;
  vec length = vec_sqrt(p[7] * p[7] + p[8] * p[8]);
  half_angle(p[7], p[8], &table.c, &table.s);
  vec c = vec_abs(table.c), s = vec_abs(table.s);
  table.sy = positive(s * (table.sx - length * c) + c * (table.sy - length * s));
  table.sx = length;
  return table;
}

/* ---- Whether the base can drive: separating axes of two rectangles, as cgtorch.tabletop.world.clear_motion ---- */

typedef struct {
  real bx, by, hx, hy; /* centre and half sides of the footprint, clearance included */
  real farthest;       /* m that a motion may drive */
} Body;

INLINE vwhole beyond(vec place, vec way, vec reach) {
  return (place - positive(way) > reach) | (place - vec_min(vec_of(0), way) < -reach);
}
INLINE vwhole drive_blocked(const vec *u, const Rectangle *r, const Body *body) {
  vec x = r->x - body->bx, y = r->y - body->by, w = r->sx / 2, h = r->sy / 2, dx = u[0], dy = u[1];
  vec c = r->c, s = r->s, along = dx * c + dy * s, across = dy * c - dx * s;
  vec ac = vec_abs(c), as = vec_abs(s);
  vwhole apart = beyond(x, dx, body->hx + ac * w + as * h);
  apart |= beyond(y, dy, body->hy + as * w + ac * h);
  apart |= beyond(x * c + y * s, along, w + ac * body->hx + as * body->hy);
  apart |= beyond(y * c - x * s, across, h + as * body->hx + ac * body->hy);
  vec reach = vec_abs(dy) * body->hx + vec_abs(dx) * body->hy + vec_abs(across) * w +
              vec_abs(along) * h;
  return ~(apart | (vec_abs(y * dx - x * dy) > reach));
}
INLINE vwhole within_reach(const vec *u, const Rectangle *r, const Body *body) {
  vec x = r->x - u[0], y = r->y - u[1];
  vec along = positive(vec_abs(x * r->c + y * r->s) - r->sx / 2);
  vec across = positive(vec_abs(y * r->c - x * r->s) - r->sy / 2);
  real rx = FN(fabs)(body->bx) + body->hx, ry = FN(fabs)(body->by) + body->hy;
  return along * along + across * across < rx * rx + ry * ry;
}
INLINE vwhole turn_blocked(const vec *u, const Rectangle *r, const Body *body) {
  vec x = r->x - u[0], y = r->y - u[1], w = r->sx / 2, h = r->sy / 2, whole_turn = wrap(u[2]);
  vwhole blocked = every(0);
  for (int i = 1; i <= TURN_STEPS; i++) {
    vec c, s;
    sine_cosine(whole_turn * ((real)i / TURN_STEPS), &s, &c);
    vec px = c * x + s * y - body->bx, py = c * y - s * x - body->by;
    vec ct = r->c * c + r->s * s; /* of the rectangle as seen from the turned body */
    s = r->s * c - r->c * s, c = ct;
    vec ac = vec_abs(c), as = vec_abs(s);
    blocked |= ~((vec_abs(px) > body->hx + ac * w + as * h) |
                 (vec_abs(py) > body->hy + as * w + ac * h) |
                 (vec_abs(px * c + py * s) > w + ac * body->hx + as * body->hy) |
                 (vec_abs(py * c - px * s) > h + as * body->hx + ac * body->hy));
  }
  return blocked;
}
/* Those of `rows` whose motion stays clear of a thing. */
INLINE vwhole clear_of(const vec *u, const Rectangle *r, const Body *body, vwhole rows) {
  vwhole beside = rows & (r->sx > 0) & (r->sy > 0);
  vwhole blocked = beside & drive_blocked(u, r, body);
  vwhole near = beside & ~blocked & (u[2] != 0) & within_reach(u, r, body);
  if (bits_of(near)) blocked |= near & turn_blocked(u, r, body);
  return rows & ~blocked;
}
INLINE vwhole is_within(const vec *u, const Body *body) {
  vwhole finite = finite_vec(u[0]) & finite_vec(u[1]) & finite_vec(u[2]);
  return finite & (vec_sqrt(u[0] * u[0] + u[1] * u[1]) <= body->farthest);
}
/* Those of `rows` whose motion is possible. */
INLINE vwhole motion_possible(const vec *p, const vec *u, Layout layout, const Body *body,
                              vwhole rows) {
  Rectangle thing = table_seen(p, layout);
  rows = clear_of(u, &thing, body, rows & is_within(u, body));
  for (int k = 0; k < layout.boxes; k++) {
    thing = box_rectangle(box_seen(p, layout, k));
    rows = clear_of(u, &thing, body, rows);
  }
  return rows;
}

/* ---- The frame of the edge nearest to the object: cgtorch.tabletop.edge_networks ---- */

#define SCENE 9
#define NOWHERE 3

typedef struct {
  vec x, y, yaw, c, s, mirror, extent[4];
} Edge;

/* The index of the least of four numbers; NaN is the least, as in torch. */
INLINE vwhole place_of_least(const vec *gaps) {
  vwhole place = every(0);
  vec least = gaps[0];
  for (int i = 1; i < 4; i++) {
    vwhole less = (gaps[i] < least) | ((gaps[i] != gaps[i]) & (least == least));
    least = select_vec(less, gaps[i], least);
    place = select_whole(less, every(i), place);
  }
  return place;
}
INLINE vec taken(const vec *four, vwhole place) {
  vec value = four[0];
  for (int i = 1; i < 4; i++) value = select_vec((place & 3) == i, four[i], value);
  return value;
}
INLINE Edge edge_frame(const vec *p, Layout layout) {
  Rectangle table = table_seen(p, layout);
  vec ax, ay, rx, ry, hx = table.sx / 2, hy = table.sy / 2, yaw = vec_of(0), quarters = yaw;
  turn(p[4] - table.x, p[5] - table.y, table.c, -table.s, &ax, &ay);
  vec gaps[4] = {hx + ax, hy + ay, hx - ax, hy - ay};
  vwhole nearest = place_of_least(gaps);
  EACH(quarters, (real)nearest[i]);
  if (layout.side) yaw = atan2_vec(p[8], p[7]) / 2;
  Edge edge = {.x = p[4], .y = p[5], .yaw = wrap(yaw + (real)(PI / 2) * quarters)};
  sine_cosine(edge.yaw, &edge.s, &edge.c);
  turn(-p[4], -p[5], edge.c, -edge.s, &rx, &ry);
  edge.mirror = select_vec(ry < 0, vec_of(-1), vec_of(1));
  vec right = taken(gaps, nearest + 1), left = taken(gaps, nearest + 3);
  edge.extent[0] = taken(gaps, nearest);
  edge.extent[1] = taken(gaps, nearest + 2);
  edge.extent[2] = select_vec(edge.mirror > 0, left, right);
  edge.extent[3] = select_vec(edge.mirror > 0, right, left);
  return edge;
}
INLINE void into_edge(const Edge *edge, vec x, vec y, vec *ex, vec *ey) {
  turn(x - edge->x, y - edge->y, edge->c, -edge->s, ex, ey);
  *ey *= edge->mirror;
}
INLINE void table_scene(const Edge *edge, const vec *p, vec *scene) {
  into_edge(edge, vec_of(0), vec_of(0), scene, scene + 1);
  scene[2] = edge->c; /* of the heading, -mirror yaw */
  scene[3] = -edge->mirror * edge->s;
  for (int i = 0; i < 4; i++) scene[4 + i] = edge->extent[i];
  scene[8] = p[6];
}
INLINE void obstacle_scene(const Edge *edge, const vec *p, Layout layout, vec *scene) {
  for (int k = 0; k < layout.boxes; k++) {
    const vec *box = box_seen(p, layout, k);
    vec x, y, *out = scene + 3 * k;
    vwhole seen = there(box);
    into_edge(edge, (box[0] + box[1]) / 2, (box[2] + box[3]) / 2, &x, &y);
    out[0] = select_vec(seen, x, vec_of(-NOWHERE));
    out[1] = select_vec(seen, y, vec_of(0));
    out[2] = select_vec(seen, ((box[1] - box[0]) + (box[3] - box[2])) / 2 / 2, vec_of(0));
  }
}
INLINE void motion_to(const Edge *edge, const vec *pose, vec *u) {
  vec wx, wy;
  turn(pose[0], pose[1] * edge->mirror, edge->c, edge->s, &wx, &wy);
  u[0] = edge->x + wx;
  u[1] = edge->y + wy;
  u[2] = wrap(edge->yaw + pose[2] * edge->mirror);
}
