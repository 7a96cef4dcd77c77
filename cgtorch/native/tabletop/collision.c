/* Whether arms touch their table and body (cgtorch.tabletop.kinematics), posture after posture. */
#include "library.h"
#include "tabletop/touching.h"

EXPORT_STRUCT(Chain)
EXPORT_STRUCT(Boxes)
EXPORT_STRUCT(Arms)
EXPORT_CONSTANTS(arm_limits, MOST_FRAMES, MOST_CAPSULES)

static void some_arms(void *what, int64_t begin, int64_t end) {
  const Arms *a = what;
  for (int64_t row = begin; row < end; row++)
    a->hit[row] = (unsigned char)arm_touches(a, row, a->q + row * a->chain.joints);
}

int arms_touch(Arms *arms, int64_t threads) {
  in_parallel(some_arms, arms, arms->postures, 256, threads);
  return DONE;
}
