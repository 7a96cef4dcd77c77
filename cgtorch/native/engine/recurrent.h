/* Networks that remember, cgtorch.actions.recurrent, of a vector of lanes. */
#pragma once
#include "networks.h"

#define OF_WEIGHTS ((real)0.5) /* what parameters count as weights, and as biases */
#define OF_BIASES ((real)0.01)

INLINE int recurrent_weights(int inputs, int hidden, int outputs) {
  return hidden * (inputs + hidden + 1) + outputs * ((hidden ? hidden : inputs) + 1);
}
INLINE vec tanh_vec(vec x) { return 2 * sigmoid_vec(2 * x) - 1; }
INLINE vec lightly(const vec *x, const real *w, const vec *columns, int first, int count, int bias) {
  return product(x, w, columns, first, count) * OF_WEIGHTS + weight(w, columns, bias) * OF_BIASES;
}
/* What networks say of `x`, percepts and then what they remember, and what they remember afterwards. */
INLINE void recurrent_layers(const vec *x, const real *w, const vec *columns, int inputs, int hidden,
                             int outputs, vec *state, vec *out) {
  const vec *told = hidden ? state : x; /* without a hidden layer, the percepts themselves */
  int seen = inputs + hidden, b = hidden * seen, v = b + hidden, last = hidden ? hidden : inputs;
  for (int i = 0; i < hidden; i++)
    state[i] = tanh_vec(lightly(x, w, columns, i * seen, seen, b + i));
  UP_TO(i, outputs, MOST_MESSAGE) out[i] = lightly(told, w, columns, v + i * last, last, v + outputs * last + i);
}
INLINE void recurrent(const vec *x, const real *w, const vec *columns, int inputs, int hidden,
                      int outputs, vec *state, vec *out) {
  if (hidden == 3) recurrent_layers(x, w, columns, inputs, 3, outputs, state, out);
  else recurrent_layers(x, w, columns, inputs, hidden, outputs, state, out);
}
