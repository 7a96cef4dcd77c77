/* Networks with one hidden layer, cgtorch.graphs.networks.one_hidden_layer, of a vector of lanes. */
#pragma once
#include "limits.h"
#include "real.h"

/* Weight i: the same for all lanes, or each lane's own in `columns`. */
INLINE vec weight(const real *w, const vec *columns, int i) {
  return columns ? columns[i] : vec_of(w[i]);
}
INLINE vec product(const vec *x, const real *w, const vec *columns, int first, int count) {
  vec total = vec_of(0);
  for (int i = 0; i < count; i++) total = vec_fma(weight(w, columns, first + i), x[i], total);
  return total;
}
INLINE vec weighted(const vec *x, const real *w, const vec *columns, int first, int count, int bias) {
  return product(x, w, columns, first, count) + weight(w, columns, bias);
}
INLINE void layers(const vec *x, const real *w, const vec *columns, int inputs, int hidden,
                   int outputs, vec *out) {
  vec at[MOST_HIDDEN];
  int b1 = hidden * inputs, w2 = b1 + hidden, b2 = w2 + outputs * hidden;
  for (int i = 0; i < hidden; i++)
    at[i] = sigmoid_vec(weighted(x, w, columns, i * inputs, inputs, b1 + i));
  UP_TO(i, outputs, MOST_MESSAGE)
    out[i] = weighted(at, w, columns, w2 + i * hidden, hidden, b2 + i);
}
INLINE void network(const vec *x, const real *w, const vec *columns, int inputs, int hidden,
                    int outputs, vec *out) {
  if (hidden == 3 && inputs == 7) layers(x, w, columns, 7, 3, outputs, out);
  else if (hidden == 3 && inputs == 9) layers(x, w, columns, 9, 3, outputs, out);
  else layers(x, w, columns, inputs, hidden, outputs, out);
}
/* The lanes with a branch's second outcome. */
INLINE vwhole branch(const vec *out) { return sigmoid_vec(out[1]) > sigmoid_vec(out[0]); }
