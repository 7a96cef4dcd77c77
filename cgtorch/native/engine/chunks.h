/* What lanes begin with. */
#pragma once
#include "task.h"
#include <stdlib.h>

INLINE void fill_chunk(const ModelEnvironment *m, const int64_t *scenarios, Chunk *chunk,
                       vec *errors) {
  Lanes *lanes = &chunk->lanes;
  vec *state[3] = {&lanes->moves, &lanes->lost, &lanes->chance};
  int64_t each = m->errors ? m->error_draws * m->size : 0;
  memset(lanes, 0, sizeof *lanes);
  for (int i = 0; i < WIDTH; i++) {
    int64_t scenario = scenarios[chunk->from + (i < chunk->count ? i : 0)];
    lanes->scenario[i] = (whole)scenario;
    for (int64_t j = 0; j < m->size; j++) lanes->percept[j][i] = m->percepts[scenario * m->size + j];
    for (int j = 0; j < 3; j++) (*state[j])[i] = m->state[scenario * 3 + j];
    for (int64_t j = 0; j < each; j++) errors[j][i] = m->errors[scenario * each + j];
  }
  chunk->errors = errors;
}

/* The first `keep` scenarios in chunks, and then the others; NULL without memory for it, else to be
   freed. */
static Chunk *chunks_of(const ModelEnvironment *m, const int64_t *scenarios, int64_t total,
                        int64_t keep, int64_t *num_chunks) {
  int64_t each = m->errors ? m->error_draws * m->size : 0, from = 0;
  int64_t count = (keep + WIDTH - 1) / WIDTH + (total - keep + WIDTH - 1) / WIDTH;
  size_t head = (size_t)count * sizeof(Chunk);
  Chunk *chunks = malloc(head + (size_t)(count * each) * BYTES + 1);
  for (int64_t c = 0; c < count && chunks; c++) {
    int64_t left = (from < keep ? keep : total) - from;
    chunks[c].from = from, chunks[c].count = left < WIDTH ? left : WIDTH;
    fill_chunk(m, scenarios, chunks + c, (vec *)((char *)chunks + head) + c * each);
    from += chunks[c].count;
  }
  *num_chunks = count;
  return chunks;
}
