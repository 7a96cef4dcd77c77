/* Selection of parents and ranking (cgtorch.evolution.selection): epsilon-lexicase selection, one parent at a
   time, the deviations that it needs, and individuals from best to worst. */
#include "graph.h"
#include "library.h"
#include "selection.h"
#include <stdlib.h>

EXPORT_STRUCT(Groups)
EXPORT_CONSTANTS(selection_limits, CANDIDATES)

typedef struct {
  int64_t scenarios, rows;     /* B, and how many different rows of scores there are */
  int64_t vectors;             /* that as many rows fill */
  real *cases;                 /* (B, vectors * WIDTH) */
  const real *epsilon;         /* (B,) */
  int64_t *members, *first;    /* individuals by row, and where those of each row begin */
  int64_t *good, *good_first;  /* rows that survive one scenario alone, and where they begin */
  vwhole *survives;            /* (B, vectors) whether a row does */
  int64_t *top;                /* (B,) the first best row */
  int64_t key;                 /* of all parents' numbers */
  int64_t *chosen;             /* (count,) */
  _Atomic int failed;          /* for want of memory */
} Lexicase;

/* Gives individuals with equal scores the same row number, in order of first appearance. */
static int64_t number_rows(const real *scores, int64_t individuals, int64_t scenarios, int64_t *row_of,
                           int64_t *table, int64_t size) {
  int64_t rows = 0;
  for (int64_t i = 0; i < size; i++) table[i] = -1;
  for (int64_t i = 0; i < individuals; i++) {
    const real *mine = scores + i * scenarios;
    int64_t at = (int64_t)(hash_of(mine, scenarios) & (uint64_t)(size - 1));
    while (table[at] >= 0 && !alike(scores + table[at] * scenarios, mine, scenarios))
      at = (at + 1) & (size - 1);
    if (table[at] < 0) {
      table[at] = i;
      row_of[i] = rows++;
    } else {
      row_of[i] = row_of[table[at]];
    }
  }
  return rows;
}

static int64_t survivors(const real *score, real epsilon, const int64_t *rows, int64_t count,
                         int64_t *left) {
  real best = -INFINITY;
  for (int64_t i = 0; i < count; i++)
    if (score[rows[i]] > best) best = score[rows[i]];
  real enough = best - epsilon;
  int64_t kept = 0;
  for (int64_t i = 0; i < count; i++) {
    left[kept] = rows[i];
    kept += score[rows[i]] >= enough;
  }
  return kept;
}

/* The same for rows with flags, a vector at a time, in columns padded with the worst score: with many
   survivors, this is faster than a list of them. `best` is at `top` at first. Returns the number of
   survivors. */
static int64_t survivors_at_once(const real *score, real epsilon, real best, int64_t top,
                                 vwhole *survives, int64_t vectors) {
  if (!survives[top / WIDTH][top % WIDTH]) {
    vec most = vec_of(-INFINITY);
    for (int64_t v = 0; v < vectors; v++)
      most = vec_max(most, select_vec(survives[v], load(score + v * WIDTH), vec_of(-INFINITY)));
    best = -least(-most);
  }
  vec enough = vec_of(best - epsilon);
  vwhole less = every(0);
  for (int64_t v = 0; v < vectors; v++) {
    survives[v] &= load(score + v * WIDTH) >= enough;
    less += survives[v];
  }
  int64_t kept = 0;
  for (int i = 0; i < WIDTH; i++) kept -= less[i];
  return kept;
}

static int64_t listed(const vwhole *survives, int64_t vectors, int64_t *left) {
  int64_t count = 0;
  for (int64_t v = 0; v < vectors; v++)
    for (uint32_t bits = bits_of(survives[v]); bits; bits &= bits - 1)
      left[count++] = v * WIDTH + first_of(bits);
  return count;
}

static void some_parents(void *what, int64_t begin, int64_t end) {
  Lexicase *l = what;
  int64_t *left = malloc((size_t)(l->rows + 1) * sizeof *left), stride = l->vectors * WIDTH;
  int32_t *case_order = malloc((size_t)(l->scenarios + 1) * sizeof *case_order);
  vwhole *survives = malloc((size_t)(l->vectors + 1) * sizeof *survives);
  int ready = left && case_order && survives;
  if (!ready) l->failed = 1;
  for (int64_t parent = begin; ready && parent < end; parent++) {
    uint64_t key = key_of(l->key, parent);
    for (int64_t j = 0; j < l->scenarios; j++) case_order[j] = (int32_t)j;
    int64_t drawn = 0, total = 0, scenario = next_case(case_order, l->scenarios, drawn++, key);
    const int64_t *rows = l->good + l->good_first[scenario];
    int64_t count = l->good_first[scenario + 1] - l->good_first[scenario];
    if (count > l->vectors) {
      memcpy(survives, l->survives + scenario * l->vectors, (size_t)l->vectors * sizeof *survives);
      while (count > l->vectors && drawn < l->scenarios) {
        scenario = next_case(case_order, l->scenarios, drawn++, key);
        const real *score = l->cases + scenario * stride;
        int64_t top = l->top[scenario];
        count = survivors_at_once(score, l->epsilon[scenario], score[top], top, survives, l->vectors);
      }
      listed(survives, l->vectors, left);
      rows = left;
    }
    while (count > 1 && drawn < l->scenarios) {
      scenario = next_case(case_order, l->scenarios, drawn++, key);
      count = survivors(l->cases + scenario * stride, l->epsilon[scenario], rows, count, left);
      rows = left;
    }
    for (int64_t i = 0; i < count; i++) total += l->first[rows[i] + 1] - l->first[rows[i]];
    int64_t place = (int64_t)(fine(key, l->scenarios) * (double)total), i = 0;
    l->chosen[parent] = 0;
    for (; i < count; i++) {
      int64_t size = l->first[rows[i] + 1] - l->first[rows[i]];
      if (place < size) {
        l->chosen[parent] = l->members[l->first[rows[i]] + place];
        break;
      }
      place -= size;
    }
  }
  free(left), free(case_order), free(survives);
}

/* Individuals sorted by their row, and where those of each row begin. */
static void sort_members(const int64_t *row_of, int64_t individuals, int64_t rows, int64_t *members,
                         int64_t *first) {
  memset(first, 0, (size_t)(rows + 1) * sizeof *first);
  for (int64_t i = 0; i < individuals; i++) first[row_of[i] + 1]++;
  for (int64_t r = 0; r < rows; r++) first[r + 1] += first[r];
  for (int64_t i = 0; i < individuals; i++) members[first[row_of[i]]++] = i;
  for (int64_t r = rows; r > 0; r--) first[r] = first[r - 1]; /* they moved on while filling */
  first[0] = 0;
}

/* The survivors of each scenario alone. */
static void survivors_of_one_case(Lexicase *l) {
  l->good_first[0] = 0;
  for (int64_t j = 0; j < l->scenarios; j++) {
    const real *score = l->cases + j * l->vectors * WIDTH;
    vwhole *survives = l->survives + j * l->vectors;
    int64_t top = 0;
    for (int64_t r = 1; r < l->rows; r++)
      if (score[r] > score[top]) top = r;
    for (int64_t v = 0; v < l->vectors; v++) survives[v] = every(-1);
    for (int64_t r = l->rows; r < l->vectors * WIDTH; r++) survives[r / WIDTH][r % WIDTH] = 0;
    survivors_at_once(score, l->epsilon[j], score[top], top, survives, l->vectors);
    l->top[j] = top;
    l->good_first[j + 1] =
        l->good_first[j] + listed(survives, l->vectors, l->good + l->good_first[j]);
  }
}

/* Parents (count,) by scores (individuals, scenarios). */
int lexicase(const real *scores, int64_t individuals, int64_t scenarios, const real *epsilon,
             int64_t key, int64_t count, int64_t *chosen, int64_t threads) {
  int64_t size = 64;
  while (size < 2 * individuals) size *= 2;
  int64_t numbers = 3 * individuals + 1 + (individuals + 2) * scenarios + 1 + size;
  int64_t most = (individuals + WIDTH - 1) / WIDTH * WIDTH * scenarios; /* with what fills rows up */
  int64_t *row_of = malloc((size_t)numbers * sizeof *row_of);
  real *cases = malloc((size_t)(most + 1) * sizeof *cases);
  vwhole *survives = malloc((size_t)(most + 1) * sizeof(whole));
  Lexicase l = {.failed = !row_of || !cases || !survives};
  if (!l.failed) {
    int64_t *members = row_of + individuals, *first = members + individuals;
    int64_t *good_first = first + individuals + 1, *top = good_first + scenarios + 1;
    int64_t *good = top + scenarios, *table = good + individuals * scenarios;
    int64_t rows = number_rows(scores, individuals, scenarios, row_of, table, size);
    int64_t vectors = (rows + WIDTH - 1) / WIDTH;
    sort_members(row_of, individuals, rows, members, first);
    for (int64_t r = 0; r < vectors * WIDTH; r++)
      for (int64_t j = 0; j < scenarios; j++)
        cases[j * vectors * WIDTH + r] =
            r < rows ? scores[members[first[r]] * scenarios + j] : -INFINITY;
    l = (Lexicase){scenarios, rows, vectors, cases, epsilon, members, first,
                   good, good_first, survives, top, key, chosen, 0};
    survivors_of_one_case(&l);
    in_parallel(some_parents, &l, count, 64, threads);
  }
  free(row_of), free(cases), free(survives);
  return l.failed ? NO_MEMORY : DONE;
}

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

#define DIGIT 11 /* bits that are sorted by at once */
#define BUCKETS (1 << DIGIT)

/* A key that is smaller for larger numbers, the same for both zeros, and smallest for NaN. */
static uint64_t downwards(real x) { return x == x ? (pattern)~ordered(x + 0) : 0; }

/* Sorts `order` by ascending key, stably, digit by digit where digits differ. Returns the array with the
   result. */
static int64_t *sorted(const uint64_t *key, int64_t count, int64_t *order, int64_t *other) {
  uint64_t any = 0, all = ~(uint64_t)0;
  for (int64_t i = 0; i < count; i++) any |= key[i], all &= key[i];
  for (int shift = 0; shift < 64; shift += DIGIT) {
    if (!((any & ~all) >> shift & (BUCKETS - 1))) continue;
    int64_t first[BUCKETS + 1] = {0}, *swap = order;
    for (int64_t i = 0; i < count; i++) first[(key[i] >> shift & (BUCKETS - 1)) + 1]++;
    for (int b = 0; b < BUCKETS; b++) first[b + 1] += first[b];
    for (int64_t i = 0; i < count; i++)
      other[first[key[order[i]] >> shift & (BUCKETS - 1)]++] = order[i];
    order = other;
    other = swap;
  }
  return order;
}

/* Indices (count,) by fitness; of equal ones by the number of nodes in actions (count, nodes), then by index.
   */
int ranking(const real *fitness, const int64_t *action, int64_t nodes, int64_t count, int64_t *out) {
  uint64_t *key = malloc((size_t)(3 * count + 1) * sizeof *key);
  if (!key) return NO_MEMORY;
  int64_t *order = (int64_t *)key + count, *other = order + count;
  for (int64_t i = 0; i < count; i++) {
    order[i] = i, key[i] = 0;
    for (int64_t j = 0; j < nodes; j++) key[i] += action[i * nodes + j] != NO_NODE;
  }
  int64_t *found = sorted(key, count, order, other);
  for (int64_t i = 0; i < count; i++) key[i] = downwards(fitness[i]);
  found = sorted(key, count, found, found == order ? other : order);
  memcpy(out, found, (size_t)count * sizeof *out);
  free(key);
  return 0;
}

typedef struct {
  int64_t *out, count;
  uint64_t key;
} Order;

static void some_places(void *what, int64_t begin, int64_t end) {
  const Order *o = what;
  for (int64_t i = begin; i < end; i++) o->out[i] = shuffled(i, o->count, o->key);
}

/* A permutation (count,) that follows from a key. */
int shuffled_order(int64_t count, int64_t key, int64_t *out, int64_t threads) {
  Order order = {out, count, (uint64_t)key};
  in_parallel(some_places, &order, count, 4096, threads);
  return DONE;
}
