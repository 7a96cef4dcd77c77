/* Γ, C (cgtorch.tabletop.models) and the check of motions (cgtorch.tabletop.world.clear_motion) for many
   rows. */
#include "models.h"
#include "library.h"

EXPORT_STRUCT(Gamma)
EXPORT_STRUCT(Classifier)
EXPORT_STRUCT(Body)

typedef struct {
  const Gamma *gamma;
  const Classifier *classifier;
  const Body *body;
  Layout layout;
  const real *percept, *motion, *things; /* (n, size), (n, 3), (n, count, 5) */
  int64_t count;
  real *out, *novelty;
  unsigned char *free;
} Rows;

static void some_percepts(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
  int size = r->layout.size;
  vec p[MOST_PERCEPT], u[3], after[MOST_PERCEPT], novelty;
  for (int64_t i = begin; i < end; i += WIDTH) {
    int64_t rows = end - i < WIDTH ? end - i : WIDTH;
    uint32_t bits = (1u << rows) - 1;
    into_columns(r->percept + i * size, rows, size, size, p);
    if (r->gamma) {
      into_columns(r->motion + i * 3, rows, 3, 3, u);
      gamma_vec(r->gamma, r->layout, p, u, bits, after, &novelty);
      into_rows(after, rows, size, r->out + i * size);
      into_rows(&novelty, rows, 1, r->novelty + i);
    } else {
      vec chance = success_vec(r->classifier, r->layout, p, bits);
      into_rows(&chance, rows, 1, r->out + i);
    }
  }
}

static void some_motions(void *what, int64_t begin, int64_t end) {
  const Rows *r = what;
  vec u[3], thing[5];
  for (int64_t i = begin; i < end; i += WIDTH) {
    int64_t rows = end - i < WIDTH ? end - i : WIDTH;
    into_columns(r->motion + i * 3, rows, 3, 3, u);
    vwhole free = is_within(u, r->body);
    for (int64_t k = 0; k < r->count; k++) {
      into_columns(r->things + (i * r->count + k) * 5, rows, r->count * 5, 5, thing);
      Rectangle found = {.x = thing[0], .y = thing[1], .sx = thing[3], .sy = thing[4]};
      sine_cosine(thing[2], &found.s, &found.c);
      free = clear_of(u, &found, r->body, free);
    }
    for (int64_t j = 0; j < rows; j++) r->free[i + j] = free[j] != 0;
  }
}

/* Next percepts (n, size) and novelties (n,) of percepts (n, size) and motions (n, 3). */
int transitions(const Gamma *gamma, int64_t size, const real *percept, const real *motion, int64_t n,
                real *after, real *novelty, int64_t threads) {
  Rows rows = {.gamma = gamma, .layout = layout_of(size), .percept = percept, .motion = motion,
               .out = after, .novelty = novelty};
  in_parallel(some_percepts, &rows, n, 256, threads);
  return DONE;
}

/* Probabilities (n,) of success at percepts (n, size). */
int successes(const Classifier *classifier, int64_t size, const real *percept, int64_t n, real *out,
              int64_t threads) {
  Rows rows = {.classifier = classifier, .layout = layout_of(size), .percept = percept, .out = out};
  in_parallel(some_percepts, &rows, n, 256, threads);
  return DONE;
}

/* Whether motions (n, 3) can be made beside things (n, count, 5). */
int motions_possible(const real *motion, const real *things, const Body *body, int64_t n, int64_t count,
                     unsigned char *free, int64_t threads) {
  Rows rows = {.body = body, .motion = motion, .things = things, .count = count, .free = free};
  in_parallel(some_motions, &rows, n, 1024, threads);
  return DONE;
}
