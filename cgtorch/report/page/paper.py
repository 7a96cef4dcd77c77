"""What Riano & McGinnity report of the four experiments: section VI, figures 3 to 10."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Experiment:
    """One of the paper's experiments.

    Attributes:
        figures: numbers of the figure of the experiment and that of the evolved graph.
        setting: what the first shows.
        graph: what the second shows and the text says of it.
        succeeded: test placements reached.
        tried: test placements.
        remark: on the result.
    """

    figures: tuple[int, int]
    setting: str
    graph: str
    succeeded: int
    tried: int
    remark: str


EXPERIMENTS = {
    "S0": Experiment(
        (3, 4),
        "The robot stands at one side of the table, the object at the edge closest to it. Only "
        "objects within the dashed ellipse can be grasped.",
        "Does what the hand-written routine did: straight to the edge, centred on the object. Two "
        "networks, ContinuousNN_5 and ContinuousNN_18, though MoveBase_13 uses the output of one.",
        5,
        5,
        "Grasped wherever it was along the closest edge, and at no other.",
    ),
    "S1": Experiment(
        (5, 6),
        "Objects along the table's left edge, as the robot sees it; the ellipse is the set M of "
        "what S0 misses.",
        "One new network in place of the two, the structure otherwise unaltered. It goes straight "
        "to an object near the edge, and else around the left edge in steps, trying to grasp.",
        5,
        5,
        "Five evenly spaced placements along the left edge.",
    ),
    "S2": Experiment(
        (7, 8),
        "Objects along the table's right edge; the ellipse is the set M of what S1 misses.",
        "The left part is the solution of S1, beside it stands a completely new one for the right "
        "side, and a branching node, Branching_42, chooses between them.",
        4,
        5,
        "The top right corner is missed every time: Branching_42 says out2 and the robot goes "
        "left.",
    ),
    "S3": Experiment(
        (9, 10),
        "Objects along the opposite edge, with the corner that S2 missed; the ellipse is the set M "
        "of what S2 misses.",
        "Far more complex. S0 is still there; S1 has a new Branching_97, which leads to "
        "ContinuousNN_72 for the way to the other side, helped by ContinuousNN_51 along the right "
        "edge. An edge from Grasp_60 to Branching_42 leads back to the final approach.",
        3,
        5,
        "The corner that S2 missed is reached, too.",
    ),
}
"""By stage."""

AROUND_SUCCEEDED, AROUND_TRIED = 34, 40
AROUND = (
    "Forty random placements around the table, after S3. Most failures come from branching nodes "
    "that send the robot to the wrong side."
)
