"""Arms that are named from one link to another: their hands, joints, and what carries them."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.description import Arm
from cgtorch.tabletop.kinematics.urdf import MOVING
from cgtorch.tabletop.robot_folder.chains import LEAST_JOINTS, slides_upright
from cgtorch.tabletop.robot_folder.structure import Structure


def hand_of(structure: Structure, arm: Arm) -> str:
    """The first link of the rigid body of an arm's tool frame."""
    joints = structure.urdf.joints_between(arm.base_link, arm.tool_frame)
    moving = [joint for joint in joints if joint.type in MOVING]
    return str(moving[-1].child if moving else arm.base_link)


def from_base(structure: Structure, arm: Arm) -> Arm:
    """An arm that begins at the base frame, if it is said to begin at a link above that."""
    below = arm.base_link in structure.hanging(structure.base)
    return arm if below else replace(arm, base_link=structure.base)


def chains_as_named(
    structure: Structure, arms: Sequence[Arm], hands: Sequence[str]
) -> tuple[list[Any], list[list[Any]]]:
    """The joints above all arms, and those of each arm: all from its link to its hand.

    RobotError if an arm has none, or two have the same joint.
    """
    before, chains = list[list[Any]](), list[list[Any]]()
    for arm, hand in zip(arms, hands, strict=True):
        path = structure.path(hand)
        above = structure.path(from_base(structure, arm).base_link)
        before.append(above)
        chains.append(path[len(above) :])
    owners: dict[str, str] = {}
    for arm, chain in zip(arms, _checked(structure, arms, chains), strict=True):
        for joint in chain:
            if (owner := owners.setdefault(joint.name, arm.name)) != arm.name:
                raise RobotError(
                    f"URDF {str(structure.urdf.path)!r}: joint {joint.name!r} moves both arms "
                    f"{owner!r} and {arm.name!r}: begin both at a link below it by --arm "
                    "NAME=BASE_LINK:TOOL_FRAME, so that it is held"
                )
    return _shared(before), chains


def chains_of_groups(
    structure: Structure, arms: Sequence[Arm], hands: Sequence[str]
) -> tuple[list[Any], list[list[Any]]]:
    """The joints that move all hands, or slide upright before them, and those of each arm alone.

    RobotError if an arm has none.
    """
    paths = [structure.path(hand) for hand in hands]
    count = len(_shared(paths)) if len(paths) > 1 else 0
    for i, joint in enumerate(paths[0][: len(paths[0]) - LEAST_JOINTS]):
        if i >= count and slides_upright(structure, joint):
            count = i + 1
    return paths[0][:count], _checked(structure, arms, [path[count:] for path in paths])


def _shared(paths: Sequence[list[Any]]) -> list[Any]:
    """The joints with which all paths begin."""
    alike = (len({joint.name for joint in each}) == 1 for each in zip(*paths, strict=False))
    return paths[0][: sum(takewhile(bool, alike))]


def _checked(structure: Structure, arms: Sequence[Arm], chains: list[list[Any]]) -> list[list[Any]]:
    for arm, chain in zip(arms, chains, strict=True):
        if not chain:
            raise RobotError(
                f"URDF {str(structure.urdf.path)!r}: arm {arm.name!r} has no joints of its own "
                f"between {arm.base_link!r} and {arm.tool_frame!r}: name other links by --arm "
                "NAME=BASE_LINK:TOOL_FRAME"
            )
    return chains
