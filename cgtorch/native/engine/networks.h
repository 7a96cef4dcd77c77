/* Networks of a vector of lanes (cgtorch.graphs.networks). */
#pragma once
#include "program.h"

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

#define OF_WEIGHTS ((real)0.5) /* what parameters count as weights, and as biases */
#define OF_BIASES ((real)0.01)
#define OF_CHANGES ((real)10)

INLINE vec tanh_vec(vec x) { return 2 * sigmoid_vec(2 * x) - 1; }
INLINE vec lightly(const vec *x, const real *w, const vec *columns, int first, int count, int bias) {
  return product(x, w, columns, first, count) * OF_WEIGHTS + weight(w, columns, bias) * OF_BIASES;
}

/* The number of a network's weights, 0 for other actions. */
INLINE int num_weights(const Action *a) {
  int inputs = (int)a->inputs, hidden = (int)a->hidden, outputs = (int)a->outputs;
  if (a->kind == RECURRENT) return hidden * (inputs + hidden + 1) + outputs * (hidden + 1);
  if (a->kind == DELAY) return outputs * (inputs * ((int)a->delays + 1) + 1);
  return hidden * (inputs + 1) + outputs * (hidden + 1);
}
/* The outputs of networks for `x`, percepts followed by their states, and their states afterwards. */
INLINE void recurrent_layers(const vec *x, const real *w, const vec *columns, int inputs, int hidden,
                             int outputs, vec *state, vec *out) {
  int seen = inputs + hidden, b = hidden * seen, v = b + hidden;
  for (int i = 0; i < hidden; i++)
    state[i] = tanh_vec(lightly(x, w, columns, i * seen, seen, b + i));
  UP_TO(i, outputs, MOST_MESSAGE)
    out[i] = lightly(state, w, columns, v + i * hidden, hidden, v + outputs * hidden + i);
}
INLINE void recurrent(const vec *x, const real *w, const vec *columns, int inputs, int hidden,
                      int outputs, vec *state, vec *out) {
  if (hidden == 3) recurrent_layers(x, w, columns, inputs, 3, outputs, state, out);
  else recurrent_layers(x, w, columns, inputs, hidden, outputs, state, out);
}

/* The outputs of networks for `x`, percepts followed by earlier ones, the latest first. */
INLINE void delayed(const vec *x, const real *w, const vec *columns, int inputs, int delays,
                    int outputs, vec *out) {
  vec seen[MOST_DELAYED];
  int count = inputs * (delays + 1);
  for (int i = 0; i < inputs; i++) seen[i] = x[i];
  for (int i = inputs; i < count; i++) seen[i] = (x[i - inputs] - x[i]) * OF_CHANGES;
  UP_TO(i, outputs, MOST_MESSAGE)
    out[i] = lightly(seen, w, columns, i * count, count, outputs * count + i);
}
