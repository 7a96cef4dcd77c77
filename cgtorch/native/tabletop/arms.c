/* Arms, row after row: inverse kinematics, whether ways are clear, and planned ways (cgtorch.tabletop.kinematics). */
#include <stdlib.h>

#include "engine/draws.h"
#include "tabletop/ways.h"

#define MOST_NODES 512
#define MOST_VIAS 16

typedef struct {
  ClosedForm form;
  const real *pose, *pan; /* (N, 4, 4) of the tool; (N, tries) */
  const int64_t *branch;  /* (N, tries) */
  real *q;                /* (N, tries, FORM_JOINTS) */
  unsigned char *reached; /* (N, tries) */
  int64_t poses, tries;
} Solutions;

EXPORT_STRUCT(Chain)
EXPORT_STRUCT(ClosedForm)
EXPORT_STRUCT(Solutions)
EXPORT_STRUCT(Scene)
EXPORT_STRUCT(Ways)
EXPORT_CONSTANTS(arm_limits, MOST_FRAMES, MOST_JOINTS, MOST_SOLIDS, MOST_PAIRS, MOST_WAYPOINTS)

static void some_solutions(void *what, int64_t begin, int64_t end) {
  const Solutions *s = what;
  for (int64_t row = begin; row < end; row++) {
    real wrist[12];
    wrist_of(&s->form, s->pose + row * 16, wrist);
    for (int64_t i = row * s->tries; i < (row + 1) * s->tries; i++) {
      const Pan pan = {s->pan[i], FN(cos)(s->pan[i]), FN(sin)(s->pan[i])};
      const real *branch = s->form.branches + 3 * s->branch[i];
      s->reached[i] = (unsigned char)solved(&s->form, branch, &pan, wrist, s->q + i * FORM_JOINTS);
    }
  }
}

int arm_solutions(Solutions *solutions, int64_t threads) {
  in_parallel(some_solutions, solutions, solutions->poses, 64, threads);
  return DONE;
}

static void some_ways(void *what, int64_t begin, int64_t end) {
  const Ways *ways = what;
  const int64_t width = ways->waypoints * ways->scene.chain.joints;
  Way way;
  for (int64_t row = begin; row < end; row++) {
    placed_in_scene(ways, row, &way);
    ways->clear[row] = (unsigned char)is_clear(&way, ways->kind[row], ways->held + row * 12,
                                               ways->q + row * width, ways->waypoints);
  }
}

int ways_clear(Ways *ways, int64_t threads) {
  in_parallel(some_ways, ways, ways->ways, 4, threads);
  return DONE;
}

/* ---- Ways around obstacles: two random trees that grow together (Kuffner & LaValle, "RRT-Connect: an
   efficient approach to single-query path planning", 2000) ---- */

typedef struct {
  Ways ways;                  /* of two waypoints each: where the arm is and where it shall go */
  const real *lower, *upper;  /* (K, joints) what random postures lie between */
  const int64_t *key;         /* (K,) of the random numbers */
  real *found;                /* (K, MOST_VIAS, joints) */
  int64_t *count;             /* (K,) postures of what is found, 0 for none */
  int64_t rounds;
  double step; /* how far a tree grows at a time, rad or m */
} Plans;
EXPORT_STRUCT(Plans)
EXPORT_CONSTANTS(plan_limits, MOST_VIAS)

typedef struct {
  real q[MOST_NODES][MOST_JOINTS];
  int64_t parent[MOST_NODES], count;
} Tree;

typedef struct {
  const Plans *plans;
  int64_t row, joints;
  Way way;
  Tree trees[2];
} Search;

static int edge_clear(Search *s, const real *a, const real *b) {
  real both[2 * MOST_JOINTS];
  memcpy(both, a, (size_t)s->joints * sizeof(real));
  memcpy(both + s->joints, b, (size_t)s->joints * sizeof(real));
  const Ways *ways = &s->plans->ways;
  return is_clear(&s->way, ways->kind[s->row], ways->held + s->row * 12, both, 2);
}

static real apart(const Search *s, const real *a, const real *b) {
  real square = 0;
  for (int64_t j = 0; j < s->joints; j++) square += (a[j] - b[j]) * (a[j] - b[j]);
  return FN(sqrt)(square);
}

static int64_t nearest(const Search *s, const Tree *tree, const real *q) {
  int64_t best = 0;
  real least = INFINITY;
  for (int64_t i = 0; i < tree->count; i++) {
    real away = apart(s, tree->q[i], q);
    if (away < least) least = away, best = i;
  }
  return best;
}

/* One step of a node towards a posture: the new node, or -1 if the way is not clear. */
static int64_t grown(Search *s, Tree *tree, int64_t node, const real *goal) {
  real away = apart(s, tree->q[node], goal), share = (real)s->plans->step / away;
  if (tree->count == MOST_NODES) return -1;
  real *next = tree->q[tree->count];
  for (int64_t j = 0; j < s->joints; j++)
    next[j] = share < 1 ? tree->q[node][j] + share * (goal[j] - tree->q[node][j]) : goal[j];
  if (!edge_clear(s, tree->q[node], next)) return -1;
  tree->parent[tree->count] = node;
  return tree->count++;
}

/* Steps towards a posture as long as the way is clear: the node there, or -1. */
static int64_t connected(Search *s, Tree *tree, const real *goal) {
  int64_t node = nearest(s, tree, goal);
  while (node >= 0 && apart(s, tree->q[node], goal) > 0) node = grown(s, tree, node, goal);
  return node;
}

/* The postures from the start over two connected nodes to the goal, without superfluous ones; returns their
   number, or 0 if there are too many. */
static int64_t shortened(Search *s, int64_t one, int64_t other, real *out) {
  const real *way[2 * MOST_NODES];
  int64_t count = 0, kept = 1;
  for (int64_t i = one; i >= 0; i = s->trees[0].parent[i]) way[count++] = s->trees[0].q[i];
  for (int64_t i = 0; i < count / 2; i++) {
    const real *swapped = way[i];
    way[i] = way[count - 1 - i], way[count - 1 - i] = swapped;
  }
  for (int64_t i = s->trees[1].parent[other]; i >= 0; i = s->trees[1].parent[i])
    way[count++] = s->trees[1].q[i];
  memcpy(out, way[0], (size_t)s->joints * sizeof(real));
  for (int64_t at = 0; at < count - 1;) {
    int64_t next = count - 1;
    while (next > at + 1 && !edge_clear(s, way[at], way[next])) next--;
    if (kept == MOST_VIAS) return 0;
    memcpy(out + kept++ * s->joints, way[next], (size_t)s->joints * sizeof(real));
    at = next;
  }
  return kept;
}

static int64_t planned(Search *s, real *out) {
  const Plans *plans = s->plans;
  const int64_t joints = s->joints, row = s->row;
  const real *ends = plans->ways.q + row * 2 * joints;
  for (int t = 0; t < 2; t++) {
    memcpy(s->trees[t].q[0], ends + t * joints, (size_t)joints * sizeof(real));
    s->trees[t].parent[0] = -1, s->trees[t].count = 1;
  }
  for (int64_t round = 0; round < plans->rounds; round++) {
    Tree *tree = s->trees + round % 2, *other = s->trees + (round + 1) % 2;
    real goal[MOST_JOINTS];
    for (int64_t j = 0; j < joints; j++) {
      real low = plans->lower[row * joints + j], high = plans->upper[row * joints + j];
      goal[j] = low + (real)uniform((uint64_t)plans->key[row], round * joints + j) * (high - low);
    }
    int64_t here = grown(s, tree, nearest(s, tree, goal), goal);
    if (here < 0) continue;
    int64_t there = connected(s, other, tree->q[here]);
    if (there >= 0)
      return round % 2 ? shortened(s, there, here, out) : shortened(s, here, there, out);
  }
  return 0;
}

static void some_plans(void *what, int64_t begin, int64_t end) {
  const Plans *plans = what;
  Search *s = malloc(sizeof *s);
  for (int64_t row = begin; row < end; row++) {
    if (!s) { plans->count[row] = -1; continue; }
    s->plans = plans, s->row = row, s->joints = plans->ways.scene.chain.joints;
    placed_in_scene(&plans->ways, row, &s->way);
    plans->count[row] = planned(s, plans->found + row * MOST_VIAS * s->joints);
  }
  free(s);
}

int ways_planned(Plans *plans, int64_t threads) {
  in_parallel(some_plans, plans, plans->ways.ways, 1, threads);
  for (int64_t row = 0; row < plans->ways.ways; row++)
    if (plans->count[row] < 0) return NO_MEMORY;
  return DONE;
}
