/* Networks with one hidden layer for a vector of lanes, `one_hidden_layer`. */
#ifndef CGTORCH_NETWORKS_H
#define CGTORCH_NETWORKS_H
#include "real.h"

#define MOST_HIDDEN 64

INLINE vec weighted(const vec *x, const real *w, int count, real bias) {
  vec total = all(0);
  for (int i = 0; i < count; i++) total += w[i] * x[i];
  return total + bias;
}
INLINE void layers(const vec *x, const real *w, int inputs, int hidden, int outputs, vec *out) {
  vec at[MOST_HIDDEN];
  const real *b1 = w + hidden * inputs, *w2 = b1 + hidden, *b2 = w2 + outputs * hidden;
  for (int i = 0; i < hidden; i++) at[i] = sigmoid_vec(weighted(x, w + i * inputs, inputs, b1[i]));
  for (int i = 0; i < outputs; i++) out[i] = weighted(at, w2 + i * hidden, hidden, b2[i]);
}
INLINE void network(const vec *x, const real *w, int inputs, int hidden, int outputs, vec *out) {
  if (hidden == 3 && inputs == 7) layers(x, w, 7, 3, outputs, out);
  else if (hidden == 3 && inputs == 9) layers(x, w, 9, 3, outputs, out);
  else layers(x, w, inputs, hidden, outputs, out);
}
/* The lanes that take a branch's second way. */
INLINE vwhole branch(const vec *out) { return sigmoid_vec(out[1]) > sigmoid_vec(out[0]); }
#endif
