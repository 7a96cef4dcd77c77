from itertools import pairwise

import torch
from support import tool_pose

from cgtorch.tabletop.kinematics import grasp_solution, load_robot
from cgtorch.tabletop.kinematics.grasping import table_slab
from cgtorch.tabletop.kinematics.touching import touches
from cgtorch.tabletop.viewer.postures import FINE, rest_postures, way_to

ROBOT = load_robot()
REST = rest_postures(ROBOT)
TABLE = torch.tensor([[0.95, 0.0, 0.0, 0.8, 1.2, 0.74]], dtype=torch.float64)


def test_arms_rest_beside_the_body_and_mirror_each_other() -> None:
    x_min, x_max, y_min, y_max = ROBOT.description.footprint
    tools = []
    for arm, q in zip(ROBOT.arms, REST, strict=True):
        assert ((q >= arm.lower) & (q <= arm.upper)).all()
        assert not touches(arm, q[None], table_slab(TABLE + torch.tensor([5.0, 0, 0, 0, 0, 0])),
                           ROBOT.body).any()  # fmt: skip
        start, end = arm.capsules.placed(arm.frames(q[None]))
        points = torch.cat([start, end], 1)[0]
        assert float(points[:, 0].min()) > x_min - 0.05
        assert float(points[:, 0].max()) < x_max + 0.05
        assert float(points[:, 1].min()) > y_min - 0.05
        assert float(points[:, 1].max()) < y_max + 0.05
        tools.append(tool_pose(arm, q)[:3, 3])
    torch.testing.assert_close(
        tools[0] * torch.tensor([1.0, -1.0, 1.0]), tools[1], atol=0.02, rtol=0
    )


def hits(way: torch.Tensor, which: int) -> bool:
    """Whether the arm touches table or body on a way, looked at finely."""
    arm, share = ROBOT.arms[which], torch.linspace(0, 1, 2 * FINE, dtype=way.dtype)[:, None]
    fine = torch.cat([a + share * (b - a) for a, b in pairwise(way)])
    slab = table_slab(TABLE.expand(len(fine), 6))
    return bool(touches(arm, fine, slab, ROBOT.body).any())


def test_the_way_to_a_grasp_goes_around_the_table() -> None:
    y = torch.linspace(-0.5, 0.5, 9, dtype=torch.float64)
    position = torch.stack([torch.full_like(y, 0.65), y, torch.full_like(y, 0.74)], 1)
    solution = grasp_solution(ROBOT, position, TABLE.expand(len(y), 6))
    assert solution.found.any()
    straight_hits, hit = 0, 0
    for i in solution.found.nonzero()[:, 0].tolist():
        which = int(solution.arm[i])
        arm, goal = ROBOT.arms[which], solution.joints[i, 0]
        way = way_to(ROBOT, arm, REST[which], goal, TABLE[0])
        torch.testing.assert_close(way[0], REST[which])
        assert float(arm.difference(way[-1], goal).abs().max()) < 1e-9
        straight_hits += hits(way[[0, -1]], which)
        hit += hits(way, which)
    assert straight_hits >= 3
    assert hit <= 1
