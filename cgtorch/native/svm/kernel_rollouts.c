/* Rollouts in the models of any domain. */
#include "kernel_environment.h"
#include "engine/resumable.h"
#include "engine/rollout.h"

EXPORT_STRUCT(KernelModels)
EXPORT_CONSTANTS(field_kinds, NUMBER, ANGLE, DISCRETE)

int kernel_rollouts(Task *task, int64_t threads) { return run(task, run_graphs, threads); }

/* Eq. 3. */
int kernel_evaluations(Task *task, int64_t threads) { return run(task, evaluate_graphs, threads); }

int kernel_resumed(Waiting *w, int64_t threads) {
  in_parallel(run_share, w, w->graphs * w->count, SHARE, threads);
  return ask_python(w, threads);
}
