/* Uniform numbers in [0, 1): three of 21 bits in a word (cgtorch.evolution.sampling). */
#ifndef CGTORCH_DRAWS_H
#define CGTORCH_DRAWS_H
#include <math.h>
#include <stdint.h>

#define IN_A_WORD 3
#define BITS 21
#define FIELD (((int64_t)1 << BITS) - 1)

static inline int64_t words_for(int64_t numbers) { return (numbers + IN_A_WORD - 1) / IN_A_WORD; }

static inline int64_t field(const int64_t *words, int64_t i) {
  return words[(uint64_t)i / IN_A_WORD] >> ((uint64_t)i % IN_A_WORD * BITS) & FIELD;
}

/* The i-th number. */
static inline float uniform(const int64_t *words, int64_t i) {
  return (float)field(words, i) * 0x1p-21f;
}

/* The first field whose number is not below `rate`. */
static inline int64_t below(float rate) {
  return rate > 0 ? (int64_t)ceilf(fminf(rate, 1) * 0x1p21f) : 0;
}

/* floor(draw * count), within 0 ... count - 1 also where the product rounds up. */
static inline int pick(float draw, int count) {
  int64_t k = (int64_t)(draw * (float)count);
  return (int)(k < 0 ? 0 : k < count ? k : count - 1);
}
#endif
