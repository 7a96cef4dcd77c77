/* Rollouts in environments in Python. */
#include "no_models.h"
#include "resumable.h"

int worlds_resumed(Waiting *w, int64_t threads) {
  in_parallel(run_share, w, w->graphs * w->count, SHARE, threads);
  return ask_python(w, threads);
}
