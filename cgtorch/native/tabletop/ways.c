/* Whether arms are clear of everything on their ways (cgtorch.tabletop.kinematics.clear_ways). */
#include "tabletop/ways.h"

EXPORT_STRUCT(Scene)
EXPORT_STRUCT(Ways)
EXPORT_CONSTANTS(way_limits, MOST_FRAMES, MOST_JOINTS, MOST_SOLIDS, MOST_PAIRS, MOST_WAYPOINTS)

static void some_ways(void *what, int64_t begin, int64_t end) {
  const Ways *ways = what;
  const int64_t joints = ways->scene.chain.joints;
  Way way;
  for (int64_t row = begin; row < end; row++) {
    int64_t first = ways->first[row], count = ways->first[row + 1] - first;
    placed_in_scene(ways, row, &way);
    ways->clear[row] = (unsigned char)is_clear(&way, ways->kind[row], ways->held + row * 12,
                                               ways->q + first * joints, count);
  }
}

int ways_clear(Ways *ways, int64_t threads) {
  in_parallel(some_ways, ways, ways->ways, 4, threads);
  return DONE;
}
