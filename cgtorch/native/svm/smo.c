/* Dual problems on one kernel matrix (cgtorch.svm.smo), by sequential minimal optimisation with libsvm's
   choice of the second coefficient (Fan, Chen & Lin 2005, WSS 2). The kernel values of the rows with the
   largest violations, and of those near to one, are gathered in the cache, where a step takes a tenth of a
   microsecond. When they are solved (Joachims 1999), the gradients of all rows are updated in double
   precision, and another set is chosen. */
#include <stdlib.h>
#include "library.h"
#include "real.h"


#define LARGEST_SET 1024
#define SMALLEST_SET 64
#define NEAR 0.1      /* of the largest violation: how near to violating a row is solved too */
#define ROUND 0.1     /* of the largest violation: what a round leaves */
#define FINER 0.25    /* of the tolerance, where the duality gap is still too large */
#define FINEST 1e-3   /* of the tolerance, below which single precision ends */
#define GATHERED 4    /* steps' work for a value that is gathered */
#define ALL_ROWS 8    /* steps for each row between two choices, where sets would be too large */
#define ADRIFT 256    /* steps for each row, after which single precision has drifted too far */
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
    if (!(high - low >= tolerance) || steps >= most) return steps;
    int64_t j = second_of_pair(s, i, high);
    step = pair_step(s, i, j, high);
    ki = s->kernel + i * s->stride;
    kj = s->kernel + j * s->stride;
  }
}

typedef struct {
  const real *kernel; /* (n, stride), n filled up to WIDTH with finite numbers */
  int64_t n, stride, count;
  const double *z, *lower, *upper; /* (count, n) */
  const double *epsilon, *tolerance; /* (count,) */
  double gap;                      /* of the objective, at most */
  double worth;                    /* kernel values that a problem may take */
  double *beta, *gradient;         /* (count, n); the gradient is K beta - z */
  double *bias, *violation;        /* (count,) */
} Problems;
EXPORT_STRUCT(Problems)

typedef struct {
  double *score, *sorted, *before;
  int32_t *index;
  real *block;
  Set set;
} Memory;

/* The largest gain of a step up, and the least cost of a step down. */
static void extremes(const Problems *p, double *high, double *low) {
  double most = -INFINITY, least_cost = INFINITY, epsilon = *p->epsilon;
  for (int64_t t = 0; t < p->n; t++) {
    double up = rising(p->beta[t], p->upper[t], epsilon) - p->gradient[t];
    double down = falling(p->beta[t], p->lower[t], epsilon) - p->gradient[t];
    most = up > most ? up : most;
    least_cost = down < least_cost ? down : least_cost;
  }
  *high = most;
  *low = least_cost;
}

/* The duality gap at a bias, as a share of the objective, of which outliers count like other rows. */
static double relative_gap(const Problems *p, double bias) {
  double gap = 0, objective = 0, most = 0, epsilon = *p->epsilon;
  for (int64_t t = 0; t < p->n; t++) {
    most += p->upper[t] - p->lower[t];
    double b = p->beta[t], r = -p->gradient[t] - bias, tube = epsilon * fabs(b);
    double over = r - epsilon, under = -r - epsilon;
    gap += p->upper[t] * (over > 0 ? over : 0) - p->lower[t] * (under > 0 ? under : 0) - r * b + tube;
    objective += 0.5 * (p->gradient[t] - p->z[t]) * b + tube;
  }
  return gap / fmin(fmax(fabs(objective), 1e-12 * most), most);
}

static double kth_largest(double *v, int64_t n, int64_t k) {
  int64_t first = 0, last = n - 1;
  while (first < last) {
    double pivot = v[(first + last) / 2];
    int64_t i = first, j = last;
    while (i <= j) {
      while (v[i] > pivot) i++;
      while (v[j] < pivot) j--;
      if (i > j) break;
      double swapped = v[i];
      v[i++] = v[j];
      v[j--] = swapped;
    }
    if (k <= j) last = j;
    else if (k >= i) first = i;
    else break;
  }
  return v[k];
}

/* Writes the rows of the next set; returns the number of all rows that violate conditions or nearly do. */
static int64_t choose(const Problems *p, double high, double low, Memory *m, int64_t *near) {
  double middle = (high + low) / 2, close = -NEAR * (high - low), epsilon = *p->epsilon;
  int64_t live = 0, count = 0;
  *near = 0;
  for (int64_t t = 0; t < p->n; t++) {
    double up = rising(p->beta[t], p->upper[t], epsilon) - p->gradient[t] - middle;
    double down = middle + p->gradient[t] - falling(p->beta[t], p->lower[t], epsilon);
    double score = up > down ? up : down;
    m->score[t] = score;
    live += score > -INFINITY;
    *near += score > close;
  }
  int64_t want = *near + *near / 4 + BLOCK;
  want = want < SMALLEST_SET ? SMALLEST_SET : want > LARGEST_SET ? LARGEST_SET : want;
  want = want < live ? want : live;
  memcpy(m->sorted, m->score, (size_t)p->n * sizeof(double));
  double last = kth_largest(m->sorted, p->n, want - 1);
  int64_t above = 0;
  for (int64_t t = 0; t < p->n; t++) above += m->score[t] > last;
  int64_t equal = want - above;
  for (int64_t t = 0; t < p->n; t++)
    if (m->score[t] > last || (m->score[t] == last && equal-- > 0)) m->index[count++] = (int32_t)t;
  return count;
}

static void gather(const Problems *p, Memory *m, int64_t count) {
  int64_t stride = (count + WIDTH - 1) / WIDTH * WIDTH;
  for (int64_t k = 0; k < count; k++) {
    const real *restrict row = p->kernel + m->index[k] * p->stride;
    real *restrict to = m->block + k * stride;
    for (int64_t e = 0; e < count; e++) to[e] = row[m->index[e]];
    for (int64_t e = count; e < stride; e++) to[e] = 0;
  }
  m->set.kernel = m->block;
  m->set.stride = stride;
}

/* Gradients are taken from their middle, where free coefficients have theirs: what is near 0 has
   digits enough for millions of small changes. */
static void fill(const Problems *p, Memory *m, int64_t count, double middle) {
  Set *s = &m->set;
  s->count = (count + WIDTH - 1) / WIDTH * WIDTH;
  s->epsilon = *p->epsilon;
  for (int64_t k = 0; k < count; k++) {
    int64_t t = m->index[k];
    m->before[k] = s->beta[k] = p->beta[t];
    s->lower[k] = p->lower[t];
    s->upper[k] = p->upper[t];
    s->gradient[k] = (real)(p->gradient[t] + middle);
    s->diagonal[k] = p->kernel[t * p->stride + t];
    set_ends(s, k);
  }
  for (int64_t k = count; k < s->count; k++) {
    s->gradient[k] = 0, s->diagonal[k] = 1;
    s->rise[k] = -INFINITY, s->fall[k] = INFINITY;
  }
}

/* Copies the set's coefficients back and updates the gradients; returns the number of changes. */
static int64_t take_over(const Problems *p, Memory *m, int64_t count) {
  int64_t changed = 0, n = p->n, k = 0;
  for (int64_t e = 0; e < count; e++) {
    double change = m->set.beta[e] - m->before[e];
    if (change == 0) continue;
    p->beta[m->index[e]] = m->set.beta[e];
    m->index[changed] = m->index[e];
    m->before[changed++] = change;
  }
  double *restrict g = p->gradient;
  for (; k + 8 <= changed; k += 8) {
    const real *restrict r[8];
    const double *c = m->before + k;
    for (int e = 0; e < 8; e++) r[e] = p->kernel + m->index[k + e] * p->stride;
    for (int64_t t = 0; t < n; t++)
      g[t] += ((c[0] * r[0][t] + c[1] * r[1][t]) + (c[2] * r[2][t] + c[3] * r[3][t])) +
              ((c[4] * r[4][t] + c[5] * r[5][t]) + (c[6] * r[6][t] + c[7] * r[7][t]));
  }
  for (; k < changed; k++) {
    const real *restrict row = p->kernel + m->index[k] * p->stride;
    double c = m->before[k];
    for (int64_t t = 0; t < n; t++) g[t] += c * row[t];
  }
  return changed;
}

/* Solves the first problem from its present state; returns the remaining violation. */
static double solve(const Problems *p, Memory *m) {
  double tolerance = *p->tolerance, finest = FINEST * tolerance, work = 0;
  for (int round = 0;; round++) {
    double high, low;
    extremes(p, &high, &low);
    double wrong = high - low;
    /* In the middle of what is optimal, as far as that is bounded. */
    if (isfinite(high) && isfinite(low)) *p->bias = (high + low) / 2;
    else *p->bias = isfinite(high) ? high : isfinite(low) ? low : 0;
    if (!(wrong > -INFINITY)) return 0; /* nothing can move */
    while (wrong < tolerance) {
      if (tolerance < finest || relative_gap(p, *p->bias) <= p->gap) return wrong;
      tolerance *= FINER;
    }
    if (work > p->worth) return wrong;
    int64_t near, count = choose(p, high, low, m, &near), most;
    if (near > LARGEST_SET || (round == 0 && 4 * near > p->n)) { /* too many to be gathered */
      for (int64_t t = 0; t < p->n; t++) m->index[t] = (int32_t)t;
      m->set.kernel = p->kernel;
      m->set.stride = p->stride;
      count = p->n;
      most = round ? ALL_ROWS * count : count;
    } else {
      gather(p, m, count);
      work += GATHERED * (double)(count * count);
      most = ADRIFT * count;
    }
    int64_t affordable = (int64_t)((p->worth - work) / (double)count) + count;
    most = most < affordable ? most : affordable;
    fill(p, m, count, (high + low) / 2);
    double aim = ROUND * wrong > 0.5 * tolerance ? ROUND * wrong : 0.5 * tolerance;
    int64_t steps = pairs(&m->set, (real)aim, most);
    if (steps == 0) return wrong; /* single precision sees nothing to do */
    work += (double)(steps * count + take_over(p, m, count) * p->n);
  }
}

static int allocate(Memory *m, int64_t n) {
  int64_t rows = n + WIDTH;
  double *d = malloc((size_t)rows * 6 * sizeof *d);
  real *r = malloc(((size_t)rows * 4 + (size_t)LARGEST_SET * LARGEST_SET) * sizeof *r);
  m->index = malloc((size_t)rows * sizeof *m->index);
  m->score = d, m->block = r;
  if (!d || !r || !m->index) return 0;
  m->sorted = d + rows, m->before = d + 2 * rows;
  m->set.beta = d + 3 * rows, m->set.lower = d + 4 * rows, m->set.upper = d + 5 * rows;
  real *vectors = r + (int64_t)LARGEST_SET * LARGEST_SET;
  m->set.gradient = vectors, m->set.rise = vectors + rows;
  m->set.fall = vectors + 2 * rows, m->set.diagonal = vectors + 3 * rows;
  return 1;
}

static void some_problems(void *what, int64_t begin, int64_t end) {
  const Problems *all = what;
  Memory memory;
  int64_t n = all->n;
  int room = allocate(&memory, n);
  for (int64_t i = begin; i < end && room; i++) {
    Problems p = *all;
    p.z += i * n, p.lower += i * n, p.upper += i * n, p.beta += i * n, p.gradient += i * n;
    p.epsilon += i, p.bias += i, p.tolerance += i;
    all->violation[i] = solve(&p, &memory);
  }
  free(memory.score), free(memory.block), free(memory.index);
}

/* Continues problems from their coefficients and gradients; writes biases and violations. */
int smo_problems(const Problems *problems, int64_t threads) {
  in_parallel(some_problems, (void *)problems, problems->count, 1, threads);
  return 0;
}
