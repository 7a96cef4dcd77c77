"""A finer search for an arm's way than the one that labels are made with; it takes far longer."""

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from cgtorch.tabletop.kinematics import arm_way, clear_ways, grasp_lines
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.inverse_kinematics import PAN_SAMPLES

SAMPLES = 4 * PAN_SAMPLES


@contextmanager
def finer_search() -> Iterator[None]:
    """Within it `graspable` and `arm_ways` look more closely.

    The pan angle is sampled four times as closely, every posture is looked at at every approach,
    and ways are planned ten times as long to many more of them.
    """
    usual = ArmModel.candidates
    with (
        patch.object(ArmModel, "candidates", lambda arm, pose: usual(arm, pose, SAMPLES)),
        patch.multiple(grasp_lines, NEAR=64, TRIED=16, PAN_SAMPLES=SAMPLES),
        patch.object(arm_way, "PLANNED", 20),
        patch.object(clear_ways, "ROUNDS", 1000),
    ):
        yield
