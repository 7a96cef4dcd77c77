/* Rollouts in the tabletop's models. */
#include "environment.h"
#include "engine/resumable.h"
#include "engine/rollout.h"

EXPORT_STRUCT(TabletopModels)

int tabletop_rollouts(Task *task, int64_t threads) { return run(task, run_graphs, threads); }

/* Eq. 3. */
int tabletop_evaluations(Task *task, int64_t threads) { return run(task, evaluate_graphs, threads); }

int tabletop_resumed(Waiting *w, int64_t threads) {
  in_parallel(run_share, w, w->graphs * w->count, SHARE, threads);
  return ask_python(w, threads);
}
