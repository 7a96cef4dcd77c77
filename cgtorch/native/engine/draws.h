/* Counter-based random numbers (cgtorch.ground.counter_rng). */
#pragma once
#ifndef __CUDACC_RTC__
#include <math.h>
#include <stdint.h>
#include <string.h>
#endif

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

/* The indices where an individual's numbers for parameters of new nodes, and for its drift, begin. */
#define FRESH ((int64_t)1 << 40)
#define DRIFT ((int64_t)1 << 41)

/* A standard normal number (cgtorch.ground.counter_rng.normal_from). */
static inline float normal(const float *quantiles, uint64_t word) {
  float chance = (float)(int64_t)((word & (((uint64_t)1 << 39) - 1)) * 2 + 1);
  int32_t bits;
  memcpy(&bits, &chance, sizeof bits);
  const float *at = quantiles + 3 * ((bits >> 18) - 127 * 32);
  float place = (float)(bits & ((1 << 18) - 1)) * 0x1p-18f;
  float size = at[0] + place * (at[1] + place * at[2]);
  return word >> 39 & 1 ? -size : size;
}

/* 2^x to seven digits, for x that are no larger than 100 (cgtorch.ground.numerics.exp2). */
static inline float power_of_two(float x) {
  static const float factors[] = {0.00015461445f, 0.0013400428f, 0.009618057f, 0.055503272f,
                                  0.24022651f,    0.6931472f,    1.0f};
  float whole_part = rintf(x), rest = x - whole_part, p = factors[0];
  int32_t bits;
  for (int i = 1; i < 7; i++) p = p * rest + factors[i];
  memcpy(&bits, &p, sizeof bits);
  bits += (int32_t)whole_part * (1 << 23);
  memcpy(&p, &bits, sizeof p);
  return p;
}

/* The place of number i of `count` in a permutation that follows from a key: a Feistel network on as many
   bits as `count` needs, repeated while the result is too large (cgtorch.ground.counter_rng.shuffled). */
static inline int64_t shuffled(int64_t i, int64_t count, uint64_t key) {
  int bits = 2;
  while ((int64_t)1 << bits < count) bits++;
  int low = bits / 2;
  uint64_t place = (uint64_t)i, right = ((uint64_t)1 << low) - 1, left = ((uint64_t)1 << (bits - low)) - 1;
  do {
    uint64_t a = place >> low, b = place & right;
    for (int round = 0; round < 6; round += 2) {
      a = (a ^ word(key, (int64_t)(b * 8) + round)) & left;
      b = (b ^ word(key, (int64_t)(a * 8) + round + 1)) & right;
    }
    place = a << low | b;
  } while (place >= (uint64_t)count);
  return (int64_t)place;
}
