/* Networks with a memory, cgtorch.graphs.recurrent and cgtorch.graphs.linear, of a vector of lanes. */
#pragma once
#include "networks.h"

#define OF_WEIGHTS ((real)0.5) /* what parameters count as weights, and as biases (light.py) */
#define OF_BIASES ((real)0.01)
#define OF_CHANGES ((real)10) /* linear.py */

INLINE vec tanh_vec(vec x) { return 2 * sigmoid_vec(2 * x) - 1; }
INLINE vec lightly(const vec *x, const real *w, const vec *columns, int first, int count, int bias) {
  return product(x, w, columns, first, count) * OF_WEIGHTS + weight(w, columns, bias) * OF_BIASES;
}

INLINE int recurrent_weights(int inputs, int hidden, int outputs) {
  return hidden * (inputs + hidden + 1) + outputs * (hidden + 1);
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

INLINE int delay_weights(int inputs, int delays, int outputs) {
  return outputs * (inputs * (delays + 1) + 1);
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
