/* RBF machines evaluated by the threads of a warp together. As many adjacent threads as a vector of a CPU has
   parts form a team, which adds up in the same order; each team has its own rows. */
#pragma once

#define TEAM (64 / (int)sizeof(real))
#define TEAMS (WARP / TEAM)
#define TEAM_ROWS 2
#define ROUND (TEAMS * TEAM_ROWS) /* rows of a warp at once */

INLINE vec of_thread(vec v, int thread) { return vec(__shfl_sync(EVERYONE, v.part, thread)); }

INLINE vec team_sum(vec v) {
  UNROLLED for (int by = TEAM / 2; by; by /= 2) v += vec(__shfl_xor_sync(EVERYONE, v.part, by));
  return v;
}
INLINE vec team_least(vec v) {
  UNROLLED for (int by = TEAM / 2; by; by /= 2)
    v = vec(FN(fmin)(v.part, __shfl_xor_sync(EVERYONE, v.part, by)));
  return v;
}

/* The values of a machine for this team's rows, those of the threads `from`, without bias. */
INLINE void team_values(const Machine *f, const vec *x, const int *from, int outputs, int features,
                        vec total[MOST_OUTPUTS][TEAM_ROWS], vec *near) {
  const real *centres = f->centres + thread_of_warp() % TEAM;
  const real *weights = f->weights + thread_of_warp() % TEAM;
  vec at[TEAM_ROWS][MOST_FEATURES];
  UNROLLED for (int r = 0; r < TEAM_ROWS; r++) {
    UP_TO(i, features, MOST_FEATURES) at[r][i] = of_thread(x[i], from[r]);
    UP_TO(o, outputs, MOST_OUTPUTS) total[o][r] = vec_of(0);
    near[r] = vec_of((real)INFINITY);
  }
  _Pragma("unroll 1") for (int j = 0; j < (int)f->m; j += TEAM) {
    vec distance[TEAM_ROWS];
    UNROLLED for (int r = 0; r < TEAM_ROWS; r++) distance[r] = vec_of(0);
    UP_TO(i, features, MOST_FEATURES) {
      vec c = load(centres + i * (int)f->m + j);
      UNROLLED for (int r = 0; r < TEAM_ROWS; r++) {
        vec gap = at[r][i] - c;
        distance[r] = vec_fma(gap, gap, distance[r]);
      }
    }
    UNROLLED for (int r = 0; r < TEAM_ROWS; r++)
      near[r] = vec(FN(fmin)(near[r].part, distance[r].part));
    exp2_minus(distance, TEAM_ROWS);
    UP_TO(o, outputs, MOST_OUTPUTS) {
      vec w = load(weights + o * (int)f->m + j);
      UNROLLED for (int r = 0; r < TEAM_ROWS; r++)
        total[o][r] = vec_fma(w, distance[r], total[o][r]);
    }
  }
  UNROLLED for (int r = 0; r < TEAM_ROWS; r++) {
    UP_TO(o, outputs, MOST_OUTPUTS) total[o][r] = team_sum(total[o][r]);
    near[r] = team_least(near[r]);
  }
}

/* The next rows of those in `left`, distributed to teams; returns the remaining ones. */
INLINE uint32_t rows_of_team(uint32_t left, int *from) {
  UNROLLED for (int team = 0; team < TEAMS; team++)
    UNROLLED for (int r = 0; r < TEAM_ROWS; r++) {
      int thread = left ? __ffs((int)left) - 1 : 0;
      if (team == thread_of_warp() / TEAM) from[r] = thread;
      left &= left - 1;
    }
  return left;
}

/* As in rbf.h, for all threads of a warp at once; those in `bits` have a row. */
INLINE void lanes_of_outputs(const Machine *f, const vec *x, uint32_t bits, int outputs, int features,
                             vec *values, vec *nearest) {
  vec scaled[MOST_FEATURES];
  vwhole finite = every(-1);
  uint32_t left = __ballot_sync(EVERYONE, bits != 0);
  int mine = bits ? __popc(left & ((1u << thread_of_warp()) - 1)) : -WARP; /* of the rows that are left */
  UP_TO(i, features, MOST_FEATURES) scaled[i] = x[i] * f->scale, finite &= x[i] * 0 == 0;
  UP_TO(o, outputs, MOST_OUTPUTS) values[o] = vec_of(0);
  *nearest = vec_of(0);
  _Pragma("unroll 1") for (; left; mine -= ROUND) {
    vec total[MOST_OUTPUTS][TEAM_ROWS], near[TEAM_ROWS];
    int from[TEAM_ROWS], served = mine >= 0 && mine < ROUND;
    int team = served ? mine / TEAM_ROWS * TEAM : 0, row = mine % TEAM_ROWS;
    left = rows_of_team(left, from);
    team_values(f, scaled, from, outputs, features, total, near);
    UNROLLED for (int r = 0; r < TEAM_ROWS; r++) {
      vwhole here = every(-(served && row == r));
      *nearest = select_vec(here, of_thread(near[r], team), *nearest);
      UP_TO(o, outputs, MOST_OUTPUTS)
        values[o] = select_vec(here, of_thread(total[o][r], team), values[o]);
    }
  }
  UP_TO(o, outputs, MOST_OUTPUTS)
    values[o] = select_vec(finite, values[o] + f->bias[o], vec_of((real)NAN));
  *nearest = select_vec(finite, *nearest, vec_of((real)NAN));
}
