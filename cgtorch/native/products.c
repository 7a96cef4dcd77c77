/* Products of sparse coefficients with a kernel matrix (cgtorch.svm.gram). */
#include "parallel.h"
#include <stdlib.h>
#include <string.h>

#define COLUMNS 512 /* of the matrix that are taken at once: those of all problems stay in the cache */

typedef struct {
  const double *matrix; /* (n, n) */
  int64_t n, problems;
  int64_t *first; /* (n + 1,) where the coefficients of each row begin */
  int64_t *which; /* of which problem each is */
  double *value;  /* and what it is */
  double *out;    /* (problems, n) */
} Product;

static void some_columns(void *what, int64_t begin, int64_t end) {
  const Product *p = what;
  for (int64_t k = 0; k < p->problems; k++)
    memset(p->out + k * p->n + begin, 0, (size_t)(end - begin) * sizeof(double));
  for (int64_t row = 0; row < p->n; row++) {
    const double *from = p->matrix + row * p->n;
    for (int64_t i = p->first[row]; i < p->first[row + 1]; i++) {
      double *out = p->out + p->which[i] * p->n, value = p->value[i];
#pragma omp simd
      for (int64_t column = begin; column < end; column++) out[column] += value * from[column];
    }
  }
}

/* Sorts the coefficients (problems, n) that are not zero by row. */
static void sort_by_row(const double *given, const Product *p) {
  memset(p->first, 0, (size_t)(p->n + 1) * sizeof *p->first);
  for (int64_t k = 0; k < p->problems; k++)
    for (int64_t row = 0; row < p->n; row++) p->first[row + 1] += given[k * p->n + row] != 0;
  for (int64_t row = 0; row < p->n; row++) p->first[row + 1] += p->first[row];
  for (int64_t k = 0; k < p->problems; k++)
    for (int64_t row = 0; row < p->n; row++) {
      double value = given[k * p->n + row];
      if (value == 0) continue;
      int64_t at = p->first[row]++;
      p->which[at] = k, p->value[at] = value;
    }
  for (int64_t row = p->n; row > 0; row--) p->first[row] = p->first[row - 1];
  p->first[0] = 0; /* they moved on while filling */
}

/* Coefficients (problems, n), `filled` of them not zero, times the matrix; 1 for want of memory. */
int gram_times(const double *matrix, int64_t n, const double *given, int64_t problems,
               int64_t filled, double *out, int64_t threads) {
  char *memory = malloc((size_t)(n + 1 + 2 * filled) * 8);
  if (!memory) return 1;
  int64_t *first = (int64_t *)memory, *which = first + n + 1;
  Product p = {matrix, n, problems, first, which, (double *)(which + filled), out};
  sort_by_row(given, &p);
  in_parallel(some_columns, &p, n, COLUMNS, threads);
  free(memory);
  return 0;
}
