/* Models of any domain for rollouts (engine/models.h): cgtorch.domains.transition and success, RBF machines
   on standardised percepts and controls. */
#pragma once
#include "angles.h"
#include "engine/models.h"
#include "rbf.h"

enum { NUMBER, ANGLE, DISCRETE };

typedef struct {
  Machine gamma, classifier;
  const int64_t *kind;           /* (D + U,) of the numbers of percepts, and then of controls */
  const real *low, *high;        /* (D + U,) bounds */
  const real *mean, *scale, *most; /* (F,) of Γ's features; how extreme the data are */
  const real *seen_mean, *seen_scale; /* (G,) of C's */
  const real *shift, *change;    /* (D,) of changes the mean, and what the machine's values count */
  int64_t size, controls;        /* D, U */
  real reach, per_distance;      /* 1 / (gamma log2 e) */
  real slope, offset;
} KernelModels;

typedef KernelModels Models;
typedef struct {
  int size;
} Layout;
typedef Layout View;

#define NOVEL_SHARE ((real)0.1) /* beyond the data by this share of their range counts as half novel */

INLINE Layout layout_of(int64_t size) { return MAKE(Layout){(int)size}; }

/* `within_bounds` of cgtorch.ground.fields; NaN stays NaN. */
INLINE vec within(vec x, int64_t kind, real low, real high) {
  if (kind == ANGLE) {
    real middle = (low + high) / 2;
    if (!(middle * 0 == 0)) middle = 0;
    x = wrap(x - middle) + middle;
  }
  return vec_min(vec_of(high), vec_max(vec_of(low), x));
}

/* `as_features`: sines and cosines in place of angles, which come last. */
INLINE int features_of(const vec *x, const int64_t *kind, int64_t count, vec *features) {
  int next = 0, angles = 0;
  for (int64_t i = 0; i < count; i++)
    if (kind[i] == ANGLE) angles++;
    else features[next++] = x[i];
  if (!angles) return next;
  for (int64_t i = 0; i < count; i++)
    if (kind[i] == ANGLE) sine_cosine(x[i], features + next, features + next + angles), next++;
  return next + angles;
}
INLINE void standardise(vec *features, int64_t count, const real *mean, const real *scale) {
  for (int64_t i = 0; i < count; i++) features[i] = (features[i] - mean[i]) / scale[i];
}

INLINE vwhole possible(const void *models, Layout layout, const vec *percept, const vec *control,
                       vwhole rows) {
  (void)layout, (void)percept;
  for (int64_t i = 0; i < ((const Models *)models)->controls; i++) rows &= finite_vec(control[i]);
  return rows;
}

INLINE vec novelty_by(const Models *m, const vec *features, vec distance) {
  vec beyond = vec_of(0);
  for (int64_t i = 0; i < m->gamma.d; i++)
    beyond += vec_max(vec_of(0), vec_abs(features[i]) / m->most[i] - 1);
  return 1 - exp2_vec(-(distance * m->per_distance / m->reach + beyond / NOVEL_SHARE));
}

APART void kernel_gamma(const Models *m, const vec *percept, const vec *control, uint32_t bits,
                        vec *after, vec *novelty) {
  vec features[MOST_FEATURES], moved[MOST_MESSAGE], value[MOST_OUTPUTS], distance;
  int64_t d = m->size;
  for (int64_t i = 0; i < m->controls; i++)
    moved[i] = within(control[i], m->kind[d + i], m->low[d + i], m->high[d + i]);
  int count = features_of(percept, m->kind, d, features);
  features_of(moved, m->kind + d, m->controls, features + count);
  standardise(features, m->gamma.d, m->mean, m->scale);
  machine_outputs(&m->gamma, features, bits, value, &distance);
  for (int64_t i = 0; i < d; i++) {
    vec x = within(percept[i] + m->shift[i] + m->change[i] * value[i], m->kind[i], m->low[i], m->high[i]);
    if (m->kind[i] == DISCRETE) EACH(x, FN(rint)(x[i]));
    after[i] = x;
  }
  *novelty = novelty_by(m, features, distance);
}
INLINE void next_percept(const void *models, Layout layout, const vec *percept, const vec *control,
                         uint32_t bits, vec *after, vec *novelty) {
  (void)layout;
  kernel_gamma((const Models *)models, percept, control, bits, after, novelty);
}

APART vec kernel_chance(const Models *m, const vec *percept, uint32_t bits) {
  vec features[MOST_FEATURES], value, distance;
  features_of(percept, m->kind, m->size, features);
  standardise(features, m->classifier.d, m->seen_mean, m->seen_scale);
  machine_lanes(&m->classifier, features, bits, (int)m->classifier.d, &value, &distance);
  return sigmoid_vec(-(m->slope * value + m->offset));
}
INLINE vec chance_of(const void *models, Layout layout, const vec *percept, uint32_t bits) {
  (void)layout;
  return kernel_chance((const Models *)models, percept, bits);
}

INLINE const vec *looked_at(int64_t kind, Layout layout, const vec *percept, vec *seen, View *view) {
  (void)kind, (void)seen;
  *view = layout;
  return percept;
}
INLINE void said(const void *models, int64_t kind, Layout layout, const vec *percept, const View *view,
                 vwhole rows, vec *out) {
  (void)models, (void)kind, (void)layout, (void)percept, (void)view, (void)rows, (void)out;
}
