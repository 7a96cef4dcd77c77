/* Median absolute deviations of scores (cgtorch.evolution.selection.deviation). */
#include "order.h"
#include "library.h"
#include <stdlib.h>

/* The k-th smallest of `count` numbers, found bit by bit: numbers below the present value are counted a
   vector at a time, which sorting does not allow. */
static real ranked(const real *numbers, whole *x, int64_t count, int64_t k) {
  pattern any = 0, all = ~(pattern)0;
  for (int64_t i = 0; i < count; i++) {
    pattern b = ordered(numbers[i]);
    any |= b, all &= b;
    x[i] = (whole)(b ^ SIGN);
  }
  pattern found = all;
  for (pattern bit = SIGN, differ = any & ~all; bit; bit >>= 1) {
    if (!(differ & bit)) continue; /* the same in all */
    whole below = (whole)(((found & ~(bit - 1)) | bit) ^ SIGN), less = 0;
    for (int64_t i = 0; i < count; i++) less += x[i] < below;
    if (less <= k) found |= bit;
  }
  return number_of(found);
}

typedef struct {
  const real *scores;
  int64_t individuals, scenarios;
  real *out;
  _Atomic int failed; /* for want of memory */
} Deviation;

static void some_scenarios(void *what, int64_t begin, int64_t end) {
  Deviation *d = what;
  int64_t n = d->individuals, half = (n - 1) / 2;
  real *column = malloc((size_t)n * 2 * sizeof *column);
  whole *x = (whole *)(column + n);
  if (!column) {
    d->failed = 1;
    return;
  }
  for (int64_t j = begin; j < end; j++) {
    for (int64_t i = 0; i < n; i++) column[i] = d->scores[i * d->scenarios + j];
    real middle = ranked(column, x, n, half);
    for (int64_t i = 0; i < n; i++)
      column[i] = column[i] < middle ? middle - column[i] : column[i] - middle;
    d->out[j] = ranked(column, x, n, half);
  }
  free(column);
}

/* Median absolute deviation of each scenario's scores, the lower one of two medians. */
int deviation(const real *scores, int64_t individuals, int64_t scenarios, real *out, int64_t threads) {
  Deviation d = {scores, individuals, scenarios, out, 0};
  in_parallel(some_scenarios, &d, scenarios, 2, threads);
  return d.failed ? NO_MEMORY : DONE;
}
