/* Steps on pairs of coefficients: sequential minimal optimisation with libsvm's choice of the second
   one (Fan, Chen & Lin 2005, WSS 2), for problems as cgtorch.svm.problems has them. */
#pragma once
#include "real.h"

#define TAU 1e-12

/* Rows that are solved together, `count` of them, a whole number of vectors. A step up of a
   coefficient gains rise - gradient, -inf at its upper end; a step down costs fall - gradient. */
typedef struct {
  int64_t count, stride;
  const real *kernel; /* (count, stride) */
  real *gradient, *rise, *fall, *diagonal;
  double *beta, *lower, *upper, epsilon;
} Set;

INLINE double rising(double beta, double upper, double epsilon) {
  return beta < upper ? (beta >= 0 ? -epsilon : epsilon) : -INFINITY;
}
INLINE double falling(double beta, double lower, double epsilon) {
  return beta > lower ? (beta > 0 ? -epsilon : epsilon) : INFINITY;
}

INLINE void set_ends(const Set *s, int64_t i) {
  s->rise[i] = (real)rising(s->beta[i], s->upper[i], s->epsilon);
  s->fall[i] = (real)falling(s->beta[i], s->lower[i], s->epsilon);
}

/* The first place of the largest number, where each part of `value` is from vector `number`. */
INLINE int64_t place_of(vec value, vwhole number, real *largest) {
  real part[WIDTH];
  whole at[WIDTH];
  memcpy(part, &value, BYTES);
  memcpy(at, &number, BYTES);
  real most = part[0];
  for (int k = 1; k < WIDTH; k++) most = part[k] > most ? part[k] : most;
  int64_t first = INT64_MAX;
  for (int k = 0; k < WIDTH; k++) {
    int64_t here = (int64_t)at[k] * WIDTH + k;
    first = part[k] == most && here < first ? here : first;
  }
  *largest = most;
  return first;
}

/* Adds step (K_i - K_j) to the gradients; gives the row with the largest gain of a step up, that
   gain, and the least cost of a step down. */
INLINE int64_t first_of_pair(const Set *s, real step, const real *ki, const real *kj, real *high,
                             real *low) {
  vec most = vec_of(-INFINITY), least_fall = vec_of(INFINITY), move = vec_of(step);
  vwhole where = {0}, number = {0};
  for (int64_t b = 0; b < s->count; b += WIDTH, number += 1) {
    vec g = vec_fma(move, load(ki + b) - load(kj + b), load(s->gradient + b));
    store(s->gradient + b, g);
    vec rise = load(s->rise + b) - g;
    vwhole more = rise > most;
    most = select_vec(more, rise, most);
    where = (number & more) | (where & ~more);
    least_fall = vec_min(least_fall, load(s->fall + b) - g);
  }
  *low = least(least_fall);
  return place_of(most, where, high);
}

/* The row that gives the largest decrease together with row i, whose gain is `high`. */
INLINE int64_t second_of_pair(const Set *s, int64_t i, real high) {
  const real *ki = s->kernel + i * s->stride;
  vec most = vec_of(-1), peak = vec_of(high), own = vec_of(s->diagonal[i]);
  vwhole where = {0}, number = {0};
  for (int64_t b = 0; b < s->count; b += WIDTH, number += 1) {
    vec slope = peak - (load(s->fall + b) - load(s->gradient + b));
    vec curve = own + load(s->diagonal + b) - 2 * load(ki + b);
    vec value = slope * slope / vec_max(curve, vec_of((real)TAU));
    value = select_vec(slope > 0, value, vec_of(-1));
    vwhole more = value > most;
    most = select_vec(more, value, most);
    where = (number & more) | (where & ~more);
  }
  real gain;
  return place_of(most, where, &gain);
}

/* The step up of row i and down of row j, which ends at a bound or at the kink of |beta| at 0. */
INLINE real pair_step(const Set *s, int64_t i, int64_t j, real high) {
  double *up = s->beta + i, *down = s->beta + j;
  double curve = (double)s->diagonal[i] + s->diagonal[j] - 2 * (double)s->kernel[i * s->stride + j];
  double slope = (double)high - ((double)s->fall[j] - s->gradient[j]);
  double top = *up >= 0 ? s->upper[i] : 0, bottom = *down <= 0 ? s->lower[j] : 0;
  double step = slope / (curve > TAU ? curve : TAU), room_up = top - *up, room_down = *down - bottom;
  if (room_up < step) step = room_up;
  if (room_down < step) step = room_down;
  *up = step == room_up ? top : *up + step;
  *down = step == room_down ? bottom : *down - step;
  set_ends(s, i);
  set_ends(s, j);
  return (real)step;
}

/* Steps until violations are below `tolerance`, at most `most`; returns their number. */
static int64_t pairs(const Set *s, real tolerance, int64_t most) {
  const real *ki = s->kernel, *kj = s->kernel;
  real step = 0;
  for (int64_t steps = 0;; steps++) {
    real high, low;
    int64_t i = first_of_pair(s, step, ki, kj, &high, &low);
    if (!(high - low >= tolerance) || steps == most) return steps;
    int64_t j = second_of_pair(s, i, high);
    step = pair_step(s, i, j, high);
    ki = s->kernel + i * s->stride;
    kj = s->kernel + j * s->stride;
  }
}
