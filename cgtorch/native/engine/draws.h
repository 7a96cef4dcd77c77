/* Random numbers that are functions of a key (cgtorch.ground.counter_rng). */
#pragma once
#include <math.h>
#include <stdint.h>

#define BITS 24 /* of a word, the upper ones, for uniform numbers; the others are for normal ones */
#define GOLDEN 0x9E3779B97F4A7C15u

/* Columns of strategies, and how many there are (cgtorch.evolution.STRATEGY). */
enum {
  CROSSOVER, ADD_NODE, DELETE_NODE, NEW_START, REPLACE_NODE, CHANGE_EDGE, MUTATE_PARAMETER, SIGMA,
  STRATEGY
};

/* SplitMix64's finalizer. */
static inline uint64_t mixed(uint64_t x) {
  x = (x ^ x >> 30) * 0xBF58476D1CE4E5B9u;
  x = (x ^ x >> 27) * 0x94D049BB133111EBu;
  return x ^ x >> 31;
}

/* The key of an individual, given that of all, and the word of its number i. */
static inline uint64_t key_of(int64_t all, int64_t row) {
  return mixed((uint64_t)all + GOLDEN * (uint64_t)(row + 1));
}
static inline uint64_t word(uint64_t key, int64_t i) {
  return mixed(key + GOLDEN * (uint64_t)(i + 1));
}

static inline int64_t field(uint64_t key, int64_t i) { return (int64_t)(word(key, i) >> (64 - BITS)); }

/* Number i, uniform in [0, 1). */
static inline float uniform(uint64_t key, int64_t i) { return (float)field(key, i) * 0x1p-24f; }

/* The first field whose number is not below `rate`. */
static inline uint64_t below(float rate) {
  return rate > 0 ? (uint64_t)ceilf(fminf(rate, 1) * 0x1p24f) : 0;
}

/* floor(draw * count), within 0 ... count - 1 also where the product rounds up. */
static inline int pick(float draw, int count) {
  int64_t k = (int64_t)(draw * (float)count);
  return (int)(k < 0 ? 0 : k < count ? k : count - 1);
}
