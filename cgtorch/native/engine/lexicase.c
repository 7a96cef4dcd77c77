/* Epsilon-lexicase selection (cgtorch.evolution.selection), one parent after the other. */
#include "cases.h"
#include "library.h"
#include <stdlib.h>

typedef struct {
  int64_t scenarios, rows;     /* B, and how many different rows of scores there are */
  int64_t vectors;             /* that as many rows fill */
  real *cases;                 /* (B, vectors * WIDTH) */
  const real *epsilon;         /* (B,) */
  int64_t *members, *first;    /* individuals by row, and where those of each row begin */
  int64_t *good, *good_first;  /* rows that stand after one scenario alone, and where they begin */
  vwhole *survives;            /* (B, vectors) whether they do */
  int64_t *top;                /* (B,) the first best row */
  int64_t key;                 /* of all parents' numbers */
  int64_t *chosen;             /* (count,) */
  _Atomic int failed;          /* for want of memory */
} Lexicase;

/* Numbers individuals of equal scores alike, in the order in which each first appears. */
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

/* The same of rows that stand or do not, a vector at a time, in columns that are filled up with what is
   worse than all: while many stand, that is faster than a list of them. `best` stands at `top` at
   first; how many are left. */
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

/* Which rows stand after one scenario alone, for each scenario. */
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
