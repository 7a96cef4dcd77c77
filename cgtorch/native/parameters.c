/* Parameters of children (cgtorch.evolution.parameters): copied from where the marks of nodes say,
   with Gaussian steps where they are hit. */
#define _DEFAULT_SOURCE /* of madvise */
#include "draws.h"
#include "parallel.h"
#include <string.h>
#include <sys/mman.h>

typedef REAL real;

typedef struct {
  const int64_t *action, *num_parameters; /* (P, N), and of each of so many actions */
  int64_t actions, nodes;
} Nodes;

static inline int64_t parameters_at(const Nodes *of, int64_t slot) {
  int64_t action = of->action[slot];
  return action < 0 || action >= of->actions ? 0 : of->num_parameters[action];
}

/* Marks nodes that have no mark with -1, -2, ..., first those of action 0, and so on, and tells after
   how many those of each action begin; the last of `first` (A + 1,) is how many there are. `where`
   (P N,) is for its own use. */
int mark_new(const int64_t *action, int64_t *marks, int64_t total, int64_t actions, int64_t *first,
             int64_t *where) {
  int64_t count = 0;
  memset(first, 0, (size_t)(actions + 1) * sizeof *first);
  for (int64_t i = 0; i < total; i++)
    if (!marks[i] && action[i] >= 0 && action[i] < actions) {
      where[count++] = i;
      marks[i] = -++first[action[i] + 1];
    }
  for (int64_t a = 0; a < actions; a++) first[a + 1] += first[a];
  for (int64_t i = 0; i < count; i++) marks[where[i]] -= first[action[where[i]]];
  return 0;
}

/* How many parameters each individual has, and where its words begin among those of all; the last
   of `first` (P + 1,) is how many words there are. */
int parameter_counts(const int64_t *action, const int64_t *num_parameters, int64_t actions,
                     int64_t nodes, int64_t *counts, int64_t *first, int64_t rows) {
  Nodes of = {action, num_parameters, actions, nodes};
  first[0] = 0;
  for (int64_t row = 0; row < rows; row++) {
    int64_t count = 0;
    for (int64_t i = 0; i < nodes; i++) count += parameters_at(&of, row * nodes + i);
    counts[row] = count;
    first[row + 1] = first[row] + words_for(count);
  }
  return 0;
}

typedef struct {
  const int64_t *counts, *first, *draws; /* (P,), (P + 1,), and words of random bits */
  const float *rate;                     /* (P,) */
  int64_t *hits;                         /* (P + 1,) where those of each individual begin */
  int32_t *which;                        /* an individual's hits, from 3 first[row] on */
} Hits;

static void some_hits(void *what, int64_t begin, int64_t end) {
  const Hits *h = what;
  for (int64_t row = begin; row < end; row++) {
    int32_t *which = h->which + h->first[row] * IN_A_WORD, count = (int32_t)h->counts[row];
    int64_t limit = below(h->rate[row]), hits = 0;
    /* Without branches, as no CPU foresees them: each number is written down, and stays if hit. */
    for (int32_t i = 0; i < count; i += IN_A_WORD) {
      int64_t word = h->draws[h->first[row] + i / IN_A_WORD];
      for (int j = 0; j < IN_A_WORD; j++) {
        which[hits] = i + j;
        hits += (word >> j * BITS & FIELD) < limit;
      }
    }
    while (hits && which[hits - 1] >= count) hits--;
    h->hits[row] = hits;
  }
}

int parameter_hits(const int64_t *counts, const int64_t *first, const int64_t *draws,
                   const float *rate, int64_t *hits, int32_t *which, int64_t rows,
                   int64_t threads) {
  Hits h = {counts, first, draws, rate, hits, which};
  in_parallel(some_hits, &h, rows, 256, (int)threads);
  int64_t total = 0;
  for (int64_t row = 0; row <= rows; row++) {
    int64_t mine = row < rows ? hits[row] : 0;
    hits[row] = total;
    total += mine;
  }
  return 0;
}

/* Asks for pages of 2 MB: to be given 34 MB in pages of 4 kB takes longer than all operators. */
static void large_pages(void *memory, size_t bytes) {
#ifdef MADV_HUGEPAGE
  const size_t size = (size_t)2 << 20;
  uintptr_t begin = ((uintptr_t)memory + size - 1) / size * size;
  uintptr_t end = ((uintptr_t)memory + bytes) / size * size;
  if (begin < end) madvise((void *)begin, end - begin, MADV_HUGEPAGE);
#else
  (void)memory, (void)bytes;
#endif
}

typedef struct {
  const int64_t *first, *hits; /* as above */
  const int32_t *which;
  const float *sigma;          /* (P,) */
  const float *normal;         /* one for each hit */
  Nodes of;
  const int64_t *marks;        /* (P, N) r + 1 for row r of `old`, -r - 1 of `fresh`, 0 for none */
  const real *old, *fresh;
  real *parameters;            /* (P, N, K) */
  int64_t most;                /* K */
} Children;

static void some_children(void *what, int64_t begin, int64_t end) {
  const Children *c = what;
  int64_t n = c->of.nodes, k = c->most;
  memset(c->parameters + begin * n * k, 0, (size_t)((end - begin) * n * k) * sizeof(real));
  for (int64_t row = begin; row < end; row++) {
    const int32_t *which = c->which + c->first[row] * IN_A_WORD;
    int64_t hit = c->hits[row], last = c->hits[row + 1], at = 0;
    which -= hit;
    for (int64_t i = row * n; i < (row + 1) * n; i++) {
      int64_t mark = c->marks[i], count = mark ? parameters_at(&c->of, i) : 0;
      if (!count) continue;
      real *parameters = c->parameters + i * k;
      memcpy(parameters, mark > 0 ? c->old + (mark - 1) * k : c->fresh + (-mark - 1) * k,
             (size_t)count * sizeof(real));
      for (; hit < last && which[hit] < at + count; hit++) {
        /* Rounded before it is added, as in torch, though products and sums may be contracted. */
        volatile float step = c->normal[hit] * c->sigma[row];
        parameters[which[hit] - at] += step;
      }
      at += count;
    }
  }
}

int parameters_of(const int64_t *first, const int64_t *hits, const int32_t *which,
                  const float *sigma, const float *normal, const int64_t *action,
                  const int64_t *num_parameters, int64_t actions, int64_t nodes,
                  const int64_t *marks, const real *old, const real *fresh, int64_t most,
                  real *parameters, int64_t rows, int64_t threads) {
  Nodes of = {action, num_parameters, actions, nodes};
  large_pages(parameters, (size_t)(rows * nodes * most) * sizeof(real));
  Children c = {first, hits, which, sigma, normal, of, marks, old, fresh, parameters, most};
  in_parallel(some_children, &c, rows, 64, (int)threads);
  return 0;
}
