"""What Riano & McGinnity report of the four experiments: section VI, figures 3 to 10."""

import torch

from cgtorch.domains.domain import Published
from cgtorch.tabletop.world import stage_scenarios

EXPERIMENTS = {
    "S0": Published(
        5,
        5,
        "Grasped wherever it was along the closest edge, and at no other.",
        (
            (
                "Figure 3",
                "Drawn after its caption. The robot stands at one side of the table, the object "
                "at the edge closest to it. Only objects within the dashed ellipse can be "
                "grasped.",
            ),
            (
                "Figure 4, the graph",
                "Does what the hand-written routine did: straight to the edge, centred on the "
                "object. Two networks, ContinuousNN_5 and ContinuousNN_18, though MoveBase_13 "
                "uses the output of one.",
            ),
        ),
    ),
    "S1": Published(
        5,
        5,
        "Five evenly spaced placements along the left edge.",
        (
            (
                "Figure 5",
                "Drawn after its caption. Objects along the table's left edge, as the robot sees "
                "it; the ellipse is the set M of what S0 misses.",
            ),
            (
                "Figure 6, the graph",
                "One new network in place of the two, the structure otherwise unaltered. It goes "
                "straight to an object near the edge, and else around the left edge in steps, "
                "trying to grasp.",
            ),
        ),
    ),
    "S2": Published(
        4,
        5,
        "The top right corner is missed every time: Branching_42 says out2 and the robot goes "
        "left.",
        (
            (
                "Figure 7",
                "Drawn after its caption. Objects along the table's right edge; the ellipse is "
                "the set M of what S1 misses.",
            ),
            (
                "Figure 8, the graph",
                "The left part is the solution of S1, beside it stands a completely new one for "
                "the right side, and a branching node, Branching_42, chooses between them.",
            ),
        ),
    ),
    "S3": Published(
        3,
        5,
        "The corner that S2 missed is reached, too.",
        (
            (
                "Figure 9",
                "Drawn after its caption. Objects along the opposite edge, with the corner that "
                "S2 missed; the ellipse is the set M of what S2 misses.",
            ),
            (
                "Figure 10, the graph",
                "Far more complex. S0 is still there; S1 has a new Branching_97, which leads to "
                "ContinuousNN_72 for the way to the other side, helped by ContinuousNN_51 along "
                "the right edge. An edge from Grasp_60 to Branching_42 leads back to the final "
                "approach.",
            ),
        ),
    ),
    "": Published(
        34,
        40,
        "Forty random placements around the table, after S3. Most failures come from branching "
        "nodes that send the robot to the wrong side.",
    ),
}
"""By stage; of all together under ""."""

ROOM = 14.0  # cm around the paper's drawings


def stage_drawing(edge: str, footprint: tuple[float, float, float, float]) -> str:
    """The paper's schematic drawing of an experiment as SVG, the robot's left to the left, in cm.

    Args:
        edge: that the stage is about; its test placements are drawn.
        footprint: base x min, x max, y min, y max (m).
    """
    tests = stage_scenarios(edge)
    depth, width = tests.table[0, 3:5].tolist()
    x, y, _ = tests.pose[0].tolist()
    objects = (-100 * tests.object.flip(1)).tolist()
    low, high = torch.tensor(objects).aminmax(dim=0)
    (cx, cy), (rx, ry) = ((low + high) / 2).tolist(), ((high - low) / 2).tolist()
    x_min, x_max, y_min, y_max = footprint
    robot = _rectangle(x + x_max, y + y_max, x_max - x_min, y_max - y_min)
    table = _rectangle(depth / 2, width / 2, depth, width)
    left, top = table[0] - ROOM, table[1] - ROOM
    box = (left, top, table[2] + 2 * ROOM, robot[1] + robot[3] + ROOM - top)
    marks = "".join(
        f'<circle class="object" cx="{a:.1f}" cy="{b:.1f}" r="3.5"/>' for a, b in objects
    )
    middle = robot[0] + robot[2] / 2
    return (
        f'<svg class="schematic" viewBox="{" ".join(f"{v:.1f}" for v in box)}" width="300" '
        'role="img" aria-label="The robot before the table, five objects along an edge within a '
        'dashed ellipse">'
        f'<rect class="table" {_sizes(table)}/><rect class="robot" {_sizes(robot)} rx="6"/>'
        f'<path class="robot" d="M {middle:.1f} {robot[1] + robot[3] / 2:.1f} V {robot[1]:.1f}"/>'
        f'{marks}<ellipse class="set" cx="{cx:.1f}" cy="{cy:.1f}" rx="{rx + 11:.1f}" '
        f'ry="{ry + 11:.1f}"/></svg>'
    )


def _rectangle(x: float, y: float, depth: float, width: float) -> tuple[float, ...]:
    """A rectangle by its far left corner, as left, top, width and height, in cm."""
    return tuple(100 * v for v in (-y, -x, width, depth))


def _sizes(box: tuple[float, ...]) -> str:
    names = ("x", "y", "width", "height")
    return " ".join(f'{name}="{v:.1f}"' for name, v in zip(names, box, strict=True))
