/* The tabletop as percepts show it: cgtorch.world.{percepts,sweep,edge_frame} and motion_possible,
   one row at a time. */
#ifndef CGTORCH_TABLETOP_H
#define CGTORCH_TABLETOP_H
#include "real.h"

#define PI 3.14159265358979323846
#define TURN_STEPS 12 /* of 15 degrees */
#define MOST_PERCEPT 64

/* What a percept's length says: whether a side of the table is seen, and how many obstacles. */
typedef struct {
  int size, side, boxes;
} Layout;

INLINE Layout layout_of(int64_t size) {
  int side = (size - 7) % 4 != 0;
  return (Layout){(int)size, side, (int)(size - 7 - 2 * side) / 4};
}

typedef struct {
  real x, y, yaw, sx, sy;
} Rectangle;

INLINE real absolute(real x) { return FN(fabs)(x); }
INLINE real positive(real x) { return x < 0 ? 0 : x; }
INLINE real wrap(real angle) {
  real turns = FN(floor)((angle + (real)PI) / (real)(2 * PI));
  return angle - (real)(2 * PI) * turns;
}
INLINE void turn(real x, real y, real angle, real *tx, real *ty) {
  real c = FN(cos)(angle), s = FN(sin)(angle);
  *tx = c * x - s * y;
  *ty = s * x + c * y;
}
INLINE Rectangle box_rectangle(const real *box) {
  return (Rectangle){(box[0] + box[1]) / 2, (box[2] + box[3]) / 2, 0, box[1] - box[0],
                     box[3] - box[2]};
}
INLINE const real *box_seen(const real *p, Layout layout, int k) {
  return p + 7 + 2 * layout.side + 4 * k;
}
INLINE int there(const real *box) {
  return box[0] != 0 || box[1] != 0 || box[2] != 0 || box[3] != 0;
}
INLINE Rectangle table_seen(const real *p, Layout layout) {
  Rectangle box = box_rectangle(p);
  if (!layout.side) return box;
  real length = FN(sqrt)(p[7] * p[7] + p[8] * p[8]), yaw = FN(atan2)(p[8], p[7]) / 2;
  real c = absolute(FN(cos)(yaw)), s = absolute(FN(sin)(yaw));
  real other = s * (box.sx - length * c) + c * (box.sy - length * s);
  return (Rectangle){box.x, box.y, yaw, length, positive(other)};
}

/* ---- Whether the base can drive: separating axes of two rectangles, as cgtorch.world.sweep ---- */

typedef struct {
  real bx, by, hx, hy; /* centre and half sides of the footprint, clearance included */
  real farthest;       /* m that a motion may drive */
} Body;

INLINE int beyond(real place, real way, real reach) {
  return place - positive(way) > reach || place - (way > 0 ? 0 : way) < -reach;
}
INLINE int drive_blocked(const real *u, Rectangle r, const Body *body) {
  real x = r.x - body->bx, y = r.y - body->by, w = r.sx / 2, h = r.sy / 2;
  real c = FN(cos)(r.yaw), s = FN(sin)(r.yaw), dx = u[0], dy = u[1];
  real along = dx * c + dy * s, across = dy * c - dx * s, ac = absolute(c), as = absolute(s);
  if (beyond(x, dx, body->hx + ac * w + as * h)) return 0;
  if (beyond(y, dy, body->hy + as * w + ac * h)) return 0;
  if (beyond(x * c + y * s, along, w + ac * body->hx + as * body->hy)) return 0;
  if (beyond(y * c - x * s, across, h + as * body->hx + ac * body->hy)) return 0;
  real reach = absolute(dy) * body->hx + absolute(dx) * body->hy + absolute(across) * w +
               absolute(along) * h;
  return !(absolute(y * dx - x * dy) > reach);
}
INLINE int within_reach(const real *u, Rectangle r, const Body *body) {
  real x = r.x - u[0], y = r.y - u[1], c = FN(cos)(r.yaw), s = FN(sin)(r.yaw);
  real along = positive(absolute(x * c + y * s) - r.sx / 2);
  real across = positive(absolute(y * c - x * s) - r.sy / 2);
  real rx = absolute(body->bx) + body->hx, ry = absolute(body->by) + body->hy;
  return along * along + across * across < rx * rx + ry * ry;
}
INLINE int turn_blocked(const real *u, Rectangle r, const Body *body) {
  real x = r.x - u[0], y = r.y - u[1], w = r.sx / 2, h = r.sy / 2, whole_turn = wrap(u[2]);
  real cy = FN(cos)(r.yaw), sy = FN(sin)(r.yaw);
  for (int i = 1; i <= TURN_STEPS; i++) {
    real turned = whole_turn * ((real)i / TURN_STEPS);
    real c = FN(cos)(turned), s = FN(sin)(turned);
    real px = c * x + s * y - body->bx, py = c * y - s * x - body->by;
    real ct = cy * c + sy * s; /* of the rectangle as seen from the turned body */
    s = sy * c - cy * s, c = ct;
    real ac = absolute(c), as = absolute(s);
    if (!(absolute(px) > body->hx + ac * w + as * h || absolute(py) > body->hy + as * w + ac * h ||
          absolute(px * c + py * s) > w + ac * body->hx + as * body->hy ||
          absolute(py * c - px * s) > h + as * body->hx + ac * body->hy))
      return 1;
  }
  return 0;
}
INLINE int is_clear(const real *u, Rectangle r, const Body *body) {
  if (!(r.sx > 0 && r.sy > 0)) return 1;
  if (drive_blocked(u, r, body)) return 0;
  return u[2] == 0 || !within_reach(u, r, body) || !turn_blocked(u, r, body);
}
INLINE int is_within(const real *u, const Body *body) {
  if (!(isfinite(u[0]) && isfinite(u[1]) && isfinite(u[2]))) return 0;
  return FN(sqrt)(u[0] * u[0] + u[1] * u[1]) <= body->farthest;
}
INLINE int motion_possible(const real *p, const real *u, Layout layout, const Body *body) {
  if (!is_within(u, body)) return 0;
  if (!is_clear(u, table_seen(p, layout), body)) return 0;
  for (int k = 0; k < layout.boxes; k++)
    if (!is_clear(u, box_rectangle(box_seen(p, layout, k)), body)) return 0;
  return 1;
}

/* ---- The edge nearest to the object, as cgtorch.world.edge_frame ---- */

#define SCENE 9
#define NOWHERE 3

typedef struct {
  real x, y, yaw, mirror, extent[4];
} Edge;

INLINE Edge edge_frame(const real *p, Layout layout) {
  Rectangle table = table_seen(p, layout);
  real ax, ay, rx, ry, hx = table.sx / 2, hy = table.sy / 2;
  turn(p[4] - table.x, p[5] - table.y, -table.yaw, &ax, &ay);
  real gaps[4] = {hx + ax, hy + ay, hx - ax, hy - ay};
  int nearest = 0;
  for (int i = 1; i < 4; i++) /* what is not a number is the least, as in torch */
    if (gaps[i] < gaps[nearest] || (gaps[i] != gaps[i] && gaps[nearest] == gaps[nearest])) nearest = i;
  Edge edge = {p[4], p[5], wrap(table.yaw + (real)(PI / 2) * nearest), 1, {0}};
  turn(-p[4], -p[5], -edge.yaw, &rx, &ry);
  edge.mirror = ry < 0 ? -1 : 1;
  real right = gaps[(nearest + 1) % 4], left = gaps[(nearest + 3) % 4];
  edge.extent[0] = gaps[nearest];
  edge.extent[1] = gaps[(nearest + 2) % 4];
  edge.extent[2] = edge.mirror > 0 ? left : right;
  edge.extent[3] = edge.mirror > 0 ? right : left;
  return edge;
}
INLINE void into(const Edge *edge, real x, real y, real *ex, real *ey) {
  turn(x - edge->x, y - edge->y, -edge->yaw, ex, ey);
  *ey *= edge->mirror;
}
INLINE void table_scene(const Edge *edge, const real *p, real *scene) {
  into(edge, 0, 0, scene, scene + 1);
  real heading = -edge->mirror * edge->yaw;
  scene[2] = FN(cos)(heading);
  scene[3] = FN(sin)(heading);
  for (int i = 0; i < 4; i++) scene[4 + i] = edge->extent[i];
  scene[8] = p[6];
}
INLINE void obstacle_scene(const Edge *edge, const real *p, Layout layout, real *scene) {
  for (int k = 0; k < layout.boxes; k++) {
    const real *box = box_seen(p, layout, k);
    real *out = scene + 3 * k;
    if (there(box)) {
      into(edge, (box[0] + box[1]) / 2, (box[2] + box[3]) / 2, out, out + 1);
      out[2] = ((box[1] - box[0]) + (box[3] - box[2])) / 2 / 2;
    } else {
      out[0] = -NOWHERE;
      out[1] = out[2] = 0;
    }
  }
}
INLINE void motion_to(const Edge *edge, const real *pose, real *u) {
  real wx, wy;
  turn(pose[0], pose[1] * edge->mirror, edge->yaw, &wx, &wy);
  u[0] = edge->x + wx;
  u[1] = edge->y + wy;
  u[2] = wrap(edge->yaw + pose[2] * edge->mirror);
}
#endif
