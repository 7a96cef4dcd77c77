/* Gradients of gating networks (cgtorch.improvement.gating_gradient), many scenarios at a time. */
#include "library.h"
#include "real.h"

typedef struct {
  const real *x;          /* (inputs, scenarios), filled up to whole vectors */
  const real *solves;     /* (nodes + 1, scenarios), more than 0 */
  const real *weight;     /* (scenarios,), 0 where filled up */
  const real *parameters; /* (restarts, nodes, size): W1 (hidden, inputs), b1, W2 (2, hidden), b2 */
  real *gradient;         /* the same */
  real *memory;           /* (restarts, nodes, VECTORS, size + 1, WIDTH) */
  real sharpness;
  int64_t scenarios, restarts, nodes, inputs, hidden;
} Gating;
EXPORT_STRUCT(Gating)

/* The numbers of one node: of its network, of its gradient, and for the present scenarios. */
typedef struct {
  const real *w1, *b1, *w2, *b2;
  vec *sum_w1, *sum_b1, *sum_w2, *sum_b2;
  vec *unit, *first, *share;
} Node;

INLINE int64_t size_of(const Gating *g) { return g->hidden * (g->inputs + 3) + 2; }

/* Vectors of a block of scenarios have sums of their own. */
INLINE Node node_of(const Gating *g, int64_t restart, int64_t j, int64_t vector) {
  int64_t row = restart * g->nodes + j;
  Node n = {.w1 = g->parameters + row * size_of(g)};
  n.b1 = n.w1 + g->hidden * g->inputs, n.w2 = n.b1 + g->hidden, n.b2 = n.w2 + 2 * g->hidden;
  n.sum_w1 = (vec *)g->memory + (row * VECTORS + vector) * (size_of(g) + 1);
  n.sum_b1 = n.sum_w1 + g->hidden * g->inputs, n.sum_w2 = n.sum_b1 + g->hidden;
  n.sum_b2 = n.sum_w2 + g->hidden, n.unit = n.sum_b2 + 1;
  n.first = n.unit + g->hidden, n.share = n.first + 1;
  return n;
}

/* The probability of a node's first outcome, and returned that of its second: 1 minus the first would lose
   what is small. */
INLINE vec forward(const Gating *g, Node n, int64_t at) {
  vec margin = vec_of(n.b2[0] - n.b2[1]);
  for (int64_t h = 0; h < g->hidden; h++) {
    vec a = vec_of(n.b1[h]);
    for (int64_t i = 0; i < g->inputs; i++)
      a = vec_fma(vec_of(n.w1[h * g->inputs + i]), load(g->x + i * g->scenarios + at), a);
    n.unit[h] = sigmoid_vec(a);
    margin = vec_fma(vec_of(n.w2[h] - n.w2[g->hidden + h]), n.unit[h], margin);
  }
  *n.first = sigmoid_vec(margin * g->sharpness);
  return sigmoid_vec(-margin * g->sharpness);
}

/* Adds the present scenarios to a node's gradient, given that of the difference of its outputs. */
INLINE void backward(const Gating *g, Node n, int64_t at, vec slope) {
  *n.sum_b2 += slope;
  for (int64_t h = 0; h < g->hidden; h++) {
    vec down = slope * n.unit[h];
    n.sum_w2[h] += down;
    vec inner = down * (1 - n.unit[h]) * (n.w2[h] - n.w2[g->hidden + h]);
    n.sum_b1[h] += inner;
    for (int64_t i = 0; i < g->inputs; i++) {
      vec *w = n.sum_w1 + h * g->inputs + i;
      *w = vec_fma(inner, load(g->x + i * g->scenarios + at), *w);
    }
  }
}

/* A member's share is the probability that it is selected, times how reliably it solves. */
INLINE void some_scenarios(const Gating *g, int64_t restart, int64_t at) {
  int64_t vector = at / WIDTH % VECTORS;
  vec passed = vec_of(1), total;
  for (int64_t j = 0; j < g->nodes; j++) {
    Node n = node_of(g, restart, j, vector);
    vec second = forward(g, n, at);
    *n.share = *n.first * passed * load(g->solves + j * g->scenarios + at);
    passed *= second;
  }
  vec behind = passed * load(g->solves + g->nodes * g->scenarios + at);
  total = behind;
  for (int64_t j = 0; j < g->nodes; j++) total += *node_of(g, restart, j, vector).share;
  vec scale = load(g->weight + at) * g->sharpness / total;
  for (int64_t j = g->nodes - 1; j >= 0; j--) {
    Node n = node_of(g, restart, j, vector);
    behind += *n.share; /* of this member and all after it */
    backward(g, n, at, scale * (behind * *n.first - *n.share));
  }
}

/* A sum of all vectors of a block. */
INLINE real of_block(const Gating *g, const vec *part) {
  return sum(VECTORS > 1 ? part[0] + part[size_of(g) + 1] : part[0]);
}

static void some_restarts(void *what, int64_t begin, int64_t end) {
  const Gating *g = what;
  int64_t room = g->nodes * (size_of(g) + 1) * BLOCK;
  for (int64_t restart = begin; restart < end; restart++) {
    real *out = g->gradient + restart * g->nodes * size_of(g);
    memset(g->memory + restart * room, 0, (size_t)room * sizeof(real));
    for (int64_t at = 0; at < g->scenarios; at += WIDTH) some_scenarios(g, restart, at);
    for (int64_t j = 0; j < g->nodes; j++) {
      Node n = node_of(g, restart, j, 0);
      for (int64_t i = 0; i < g->hidden * (g->inputs + 1); i++) *out++ = of_block(g, n.sum_w1 + i);
      for (int64_t h = 0; h < g->hidden; h++) *out++ = of_block(g, n.sum_w2 + h);
      for (int64_t h = 0; h < g->hidden; h++) *out++ = -of_block(g, n.sum_w2 + h);
      *out++ = of_block(g, n.sum_b2), *out++ = -of_block(g, n.sum_b2);
    }
  }
}

/* The gradient of the weighted negative log-probability that scenarios reach members that solve them. */
int gating_gradients(const Gating *gating, int64_t threads) {
  in_parallel(some_restarts, (void *)gating, gating->restarts, 1, threads);
  return DONE;
}
