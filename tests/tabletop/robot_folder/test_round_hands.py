"""Hands whose fingers stand around an axis: each opens outward, and they close to their middle."""

import math

import numpy as np
import pytest
from small_urdfs import box, chain, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.hands import open_fingers, tool_of
from cgtorch.tabletop.robot_folder.round_hands import around
from cgtorch.tabletop.robot_folder.structure import Structure

ARM = link("base", box("0.2 0.2 0.5", "0 0 0.25")) + chain("arm", 6, "base", first="0 0 0.5")
ENDS = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
TURNS = [step * math.tau / 3 for step in (0, 1, -1)]
BONE = box("0.01 0.01 0.04", "0 0 0.02")


def finger(i, turn, sign=1, ends=(-0.4, 0.9), distal="", leader="", kind="revolute", far=0.035):
    """A finger that turns outward about the way around the hand, or slides outward."""
    way = math.cos(turn), math.sin(turn)
    axis = way if kind == "prismatic" else (-way[1], way[0])
    axis = " ".join(str(sign * x) for x in (*axis, 0))
    at = " ".join(str(far * x) for x in (*way, 1))
    more = ENDS.format(*ends) + leader
    parts = link(f"f{i}", BONE) + joint(f"f{i}", "arm5", at, axis, kind, more)
    if distal:
        parts += link(f"d{i}", BONE) + joint(f"d{i}", f"f{i}", "0 0 0.04", axis, more=distal)
    return parts


def three(**words):
    return [finger(i, turn, **words) for i, turn in enumerate(TURNS)]


def mimic(leader, factor=1.0):
    return f'<mimic joint="{leader}_joint" multiplier="{factor}"/>'


INWARD = ENDS.format(-1, 0)
LED = [finger(i, turn, leader=mimic("f0") if i else "") for i, turn in enumerate(TURNS)]
DRIVEN = [
    link("drive", "") + joint("drive", "arm5", "0 0 0"),
    *(finger(i, turn, leader=mimic("drive", 0.5)) for i, turn in enumerate(TURNS)),
]
CURLED = [finger(i, turn, distal=INWARD + mimic(f"f{i}", -0.6)) for i, turn in enumerate(TURNS)]
SLIDES = three(kind="prismatic", ends=(0, 0.03))


@pytest.mark.parametrize(
    ("hand", "opened"),
    [
        (three(), [0.9] * 3),
        (three(sign=-1, ends=(-0.9, 0.4)), [-0.9] * 3),
        (three(distal=INWARD), [0.9, 0.0] * 3),
        (CURLED, [0.9] * 3),
        (LED, [0.9]),
        (DRIVEN, [1.0]),
        (SLIDES, [0.03] * 3),
        ([finger(i, i * math.tau / 4) for i in range(4)], [0.9] * 4),
    ],
)  # fmt: skip
def test_each_finger_opens_outward_and_the_tool_frame_is_in_their_middle(tmp_path, hand, opened):
    urdf = load_urdf(urdf_of(tmp_path, ARM, *hand))
    structure = Structure(urdf, "base")
    found = open_fingers(structure, "arm5")
    assert sorted(found.values()) == pytest.approx(sorted(opened))
    tool = tool_of(structure, "arm5")
    assert tool.pose[:2, 3] == pytest.approx([0, 0], abs=1e-9)
    assert tool.pose[:3, 0] == pytest.approx([0, 0, 1])
    assert abs(tool.pose[:3, 1] @ [1, 0, 0]) == pytest.approx(1)  # to the first finger


@pytest.mark.parametrize(
    "hand",
    [
        three()[:2],
        [finger(i, turn) for i, turn in enumerate((0.0, 1.5, -1.5))],  # not evenly
        [finger(i, turn, far=0.035 + 0.01 * i) for i, turn in enumerate(TURNS)],
        [finger(i, turn, sign=-1 if i else 1) for i, turn in enumerate(TURNS)],
        [*three()[:2], SLIDES[2]],
        [finger(i, turn, leader=mimic("f0", -1) if i else "") for i, turn in enumerate(TURNS)],
    ],
)
def test_other_hands_are_none_of_these(tmp_path, hand):
    assert around(Structure(load_urdf(urdf_of(tmp_path, ARM, *hand)), "base"), "arm5") == []


def test_fingers_in_a_row_are_none_of_these(tmp_path):
    row = [link(f"f{i}", BONE) + joint(f"f{i}", "arm5", f"0 {0.02 * i} 0.03") for i in range(3)]
    structure = Structure(load_urdf(urdf_of(tmp_path, ARM, *row)), "base")
    assert around(structure, "arm5") == []
    assert np.isfinite(tool_of(structure, "arm5").pose).all()
