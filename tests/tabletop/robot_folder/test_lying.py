"""An arm of a URDF in which another axis than z is up is told, with what turns it."""

import numpy as np
import pytest
from small_urdfs import box, chain, link, urdf_of
from trimesh.transformations import euler_matrix

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.lying import TURNS
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose

BASE = link("base", box("0.2 0.2 0.2"))


def notes_of(tmp_path, *arms):
    found = propose(load_urdf(urdf_of(tmp_path, BASE, *arms)), Wishes())
    return [note for note in found.notes if "turns about the" in note]


@pytest.mark.parametrize("name", TURNS)
def test_an_arm_that_stands_along_another_axis_is_told(tmp_path, name):
    up = np.array([name[-1] == each for each in "xyz"]) * (-1.0 if name[0] == "-" else 1.0)
    words = " ".join(map(str, up))
    ahead = " ".join(str(0.1 * x) for x in up)
    arm = chain("arm", 6, "base", ahead).replace('"0 0 1"', f'"{words}"', 1)
    (note,) = notes_of(tmp_path, arm)
    assert note.startswith(f"'arm0_joint' turns about the {name} of 'base', along which")
    turn = euler_matrix(*map(float, TURNS[name].split()), "sxyz")[:3, :3]
    np.testing.assert_allclose(turn @ up, [0, 0, 1], atol=1e-4)
    assert note.endswith(f'rpy="{TURNS[name]}"')


def test_others_are_not(tmp_path):
    assert not notes_of(tmp_path, chain("arm", 6, "base"))
    aside = chain("arm", 6, "base", first="0 0.2 0.3").replace('"0 0 1"', '"0 1 0"', 1)
    assert not notes_of(tmp_path, aside)  # a shoulder
    two = (
        chain(f"arm{i}_", 6, "base", f"0 {y} 0").replace('"0 0 1"', '"0 1 0"', 1)
        for i, y in enumerate((0.1, -0.1))
    )
    assert not notes_of(tmp_path, *two)
