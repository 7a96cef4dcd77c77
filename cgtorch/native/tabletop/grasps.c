/* The best grasp for each line of the tool, of arms with a closed form, line after line
   (cgtorch.tabletop.kinematics.grasps looks for the same by other arms). */
#include <stdlib.h>

#include "tabletop/ways.h"

#define MOST_POSTURES 4096
#define MOST_LINE 64
#define PLACES 5 /* pre-grasp, half-way, grasp, half-way up and lifted */

enum { REACH = 1, APPROACH = 2, LIFT = 4, POSTURE = 16 }; /* kinds of ways */
enum { NONE, BLOCKED, STRAIGHT };

typedef struct {
  Ways ways;       /* tables and objects of rows (B,) */
  ClosedForm form;
  const real *path, *home;         /* (M, PLACES, 4, 4) of the tool; (joints,) */
  const int64_t *at;               /* (M,) row of each line */
  const unsigned char *continuous; /* (joints,) */
  real *line, *held;               /* (M, steps, joints), (M, 3, 4) */
  int64_t *state;                  /* (M,) */
  int64_t lines, steps, near, tried;
  int64_t few, sparse;             /* of more postures than a few every so many is tried first */
  double most_step, most_turn;     /* rad or m between places, and between steps */
} Grasps;
EXPORT_STRUCT(Grasps)

typedef struct {
  const real *branch;
  const Pan *pan;
  real away;       /* from home at the pre-grasp */
  real q[FORM_JOINTS];
} Posture;

typedef struct {
  const Grasps *grasps;
  int64_t line, count;
  real wrist[PLACES][12], held[12];
  Pan pans[MOST_POSTURES];
  Posture postures[MOST_POSTURES], *chosen[MOST_POSTURES];
  Way way;
} Search;

static real difference(const Grasps *g, int j, real a, real b) {
  real away = a - b;
  return g->continuous[j] ? away - FULL_TURN * FN(rint)(away / FULL_TURN) : away;
}

static real farthest_joint(const Grasps *g, const real *a, const real *b) {
  real most = 0;
  for (int j = 0; j < FORM_JOINTS; j++) {
    real away = FN(fabs)(difference(g, j, a[j], b[j]));
    if (away > most) most = away;
  }
  return most;
}

/* The poses of the wrist, and of the held object in the tool frame at the grasp. */
static void begin_line(Search *s, int64_t line) {
  const Grasps *g = s->grasps;
  const real *path = g->path + line * PLACES * 16, *grasp = path + 2 * 16;
  const real *object = g->ways.object + g->at[line] * 12;
  s->line = line;
  for (int i = 0; i < PLACES; i++) wrist_of(&g->form, path + i * 16, s->wrist[i]);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++) {
      s->held[i * 4 + j] = 0;
      for (int k = 0; k < 3; k++)
        s->held[i * 4 + j] += grasp[k * 4 + i] * (object[k * 4 + j] - (j == 3 ? grasp[k * 4 + 3] : 0));
    }
}

static void find_pans(Search *s) {
  const ClosedForm *form = &s->grasps->form;
  for (int64_t i = 0; i < form->samples; i++)
    s->pans[i] = (Pan){form->pans[i], FN(cos)(form->pans[i]), FN(sin)(form->pans[i])};
}

/* The postures at the grasp, at all pan angles and in all branches. */
static void find_postures(Search *s) {
  const ClosedForm *form = &s->grasps->form;
  s->count = 0;
  for (int64_t i = 0; i < form->samples; i++) {
    const Pan *pan = s->pans + i;
    real at[3];
    if (!(FN(fabs)(elbow_of(form, pan->cosine, pan->sine, s->wrist[2], at)) <= 1)) continue;
    for (int64_t k = 0; k < form->count; k++) {
      Posture *next = s->postures + s->count;
      next->branch = form->branches + k * 3, next->pan = pan;
      s->count += solved(form, next->branch, pan, s->wrist[2], next->q);
    }
  }
}

static int nearer_home(const void *a, const void *b) {
  const Posture *one = *(Posture *const *)a, *other = *(Posture *const *)b;
  if (one->away != other->away) return one->away < other->away ? -1 : 1;
  return one < other ? -1 : 1;
}

/* The postures that reach the pre-grasp, those nearest to home first, and their number. */
static int64_t choose(Search *s, int soon) {
  const Grasps *g = s->grasps;
  int64_t count = 0;
  for (int64_t i = 0; i < s->count; i++) {
    Posture *p = s->postures + i;
    real before[FORM_JOINTS];
    if ((s->count <= g->few || i % g->sparse == 0) != soon ||
        !solved(&g->form, p->branch, p->pan, s->wrist[0], before))
      continue;
    p->away = farthest_joint(g, before, g->home), s->chosen[count++] = p;
  }
  qsort(s->chosen, (size_t)count, sizeof *s->chosen, nearer_home);
  return count;
}

/* Whether a posture can follow the places, clear of table and body. */
static int followed(Search *s, const Posture *p, real joints[PLACES][FORM_JOINTS]) {
  static const int ORDER[] = {0, 4, 1, 3}; /* after the grasp */
  const Grasps *g = s->grasps;
  for (int i = 0; i < PLACES; i++)
    if (!solved(&g->form, p->branch, p->pan, s->wrist[i], joints[i]) ||
        (i && farthest_joint(g, joints[i], joints[i - 1]) >= (real)g->most_step))
      return 0;
  if (!is_clear(&s->way, POSTURE, s->held, p->q, 1)) return 0;
  for (int i = 0; i < 4; i++)
    if (!is_clear(&s->way, POSTURE, s->held, joints[ORDER[i]], 1)) return 0;
  return 1;
}

/* Whether the tool stays on its line without a joint moving too fast; writes the joints. */
static int on_line(const Search *s, const Posture *p, real *line) {
  const Grasps *g = s->grasps;
  const int64_t half = g->steps / 2;
  for (int64_t step = 0; step < g->steps; step++) {
    const int up = step > half;
    const real *a = s->wrist[up ? 2 : 0], *b = s->wrist[up ? 4 : 2];
    real share = (real)(step - up * half) / (real)half, wrist[12], here[FORM_JOINTS];
    for (int i = 0; i < 12; i++) wrist[i] = a[i] + share * (b[i] - a[i]);
    if (!solved(&g->form, p->branch, p->pan, wrist, here)) return 0;
    for (int j = 0; j < FORM_JOINTS; j++) {
      real before = step ? line[(step - 1) * FORM_JOINTS + j] : g->home[j];
      real turn = difference(g, j, here[j], before);
      if (step && !(FN(fabs)(turn) < (real)g->most_turn)) return 0;
      line[step * FORM_JOINTS + j] = before + turn;
    }
  }
  return 1;
}

/* Whether there is a way along the line, and from home to it, in a posture that can be followed. */
static int64_t state_of(Search *s, const Posture *p, real *line) {
  const Grasps *g = s->grasps;
  const int64_t half = g->steps / 2;
  real reach[2 * FORM_JOINTS];
  if (!on_line(s, p, line) || !is_clear(&s->way, APPROACH, s->held, line, half + 1) ||
      !is_clear(&s->way, LIFT, s->held, line + half * FORM_JOINTS, g->steps - half))
    return NONE;
  memcpy(reach, g->home, sizeof reach / 2), memcpy(reach + FORM_JOINTS, line, sizeof reach / 2);
  return is_clear(&s->way, REACH, s->held, reach, 2) ? STRAIGHT : BLOCKED;
}

/* Tries the postures nearest to home and keeps the first with a straight way, else the first. */
static int64_t tried(Search *s, int soon, int64_t state) {
  const Grasps *g = s->grasps;
  const int64_t size = g->steps * FORM_JOINTS, count = choose(s, soon);
  real line[MOST_LINE * FORM_JOINTS], joints[PLACES][FORM_JOINTS];
  for (int64_t i = 0, near = 0, looks = 0; i < count && near < g->near && looks < g->tried; i++) {
    if (!followed(s, s->chosen[i], joints)) continue;
    near++;
    if (!is_clear(&s->way, APPROACH, s->held, joints[2], 1)) continue;
    looks++;
    int64_t found = state_of(s, s->chosen[i], line);
    if (found > state) {
      memcpy(g->line + s->line * size, line, (size_t)size * sizeof(real));
      memcpy(g->held + s->line * 12, s->held, sizeof s->held);
      state = found;
    }
    if (state == STRAIGHT) break;
  }
  return state;
}

static void some_lines(void *what, int64_t begin, int64_t end) {
  const Grasps *g = what;
  Search *s = malloc(sizeof *s);
  if (s) s->grasps = g, find_pans(s);
  for (int64_t line = begin; line < end; line++) {
    g->state[line] = s ? NONE : -1;
    if (!s) continue;
    begin_line(s, line), find_postures(s);
    if (!s->count) continue;
    placed_in_scene(&g->ways, g->at[line], &s->way);
    g->state[line] = tried(s, 1, NONE);
    if (g->state[line] != STRAIGHT) g->state[line] = tried(s, 0, g->state[line]);
  }
  free(s);
}

int grasps_found(Grasps *grasps, int64_t threads) {
  in_parallel(some_lines, grasps, grasps->lines, 64, threads);
  for (int64_t line = 0; line < grasps->lines; line++)
    if (grasps->state[line] < 0) return NO_MEMORY;
  return DONE;
}
