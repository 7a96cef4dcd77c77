/* Γ and C for many rows (cgtorch.svm.compiled). */
#include "models.h"
#include "parallel.h"

#define PIECE 256

typedef struct {
  const Gamma *gamma;
  const Classifier *classifier;
  Layout layout;
  const real *percept, *motion;
  real *out, *novelty;
} Rows;

static void some_transitions(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
  int size = r->layout.size;
  vec p[MOST_PERCEPT], u[3], after[MOST_PERCEPT], novelty;
  for (int64_t i = begin; i < end; i += WIDTH) {
    int64_t rows = end - i < WIDTH ? end - i : WIDTH;
    into_columns(r->percept + i * size, rows, size, size, p);
    into_columns(r->motion + i * 3, rows, 3, 3, u);
    gamma_vec(r->gamma, r->layout, p, u, (1u << rows) - 1, after, &novelty);
    into_rows(after, rows, size, r->out + i * size);
    into_rows(&novelty, rows, 1, r->novelty + i);
  }
}
static void some_successes(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
  int size = r->layout.size;
  vec p[MOST_PERCEPT], chance;
  for (int64_t i = begin; i < end; i += WIDTH) {
    int64_t rows = end - i < WIDTH ? end - i : WIDTH;
    into_columns(r->percept + i * size, rows, size, size, p);
    chance = success_vec(r->classifier, r->layout, p, (1u << rows) - 1);
    into_rows(&chance, rows, 1, r->out + i);
  }
}

/* Next percepts (n, size) and novelties (n,) of percepts (n, size) and motions (n, 3). */
int transitions(const Gamma *gamma, int64_t size, const real *percept, const real *motion, int64_t n,
                real *after, real *novelty, int64_t threads) {
  Rows rows = {gamma, NULL, layout_of(size), percept, motion, after, novelty};
  in_parallel(some_transitions, &rows, n, PIECE, threads);
  return 0;
}

/* Probabilities (n,) of success at percepts (n, size). */
int successes(const Classifier *classifier, int64_t size, const real *percept, int64_t n, real *out,
              int64_t threads) {
  Rows rows = {NULL, classifier, layout_of(size), percept, NULL, out, NULL};
  in_parallel(some_successes, &rows, n, PIECE, threads);
  return 0;
}
