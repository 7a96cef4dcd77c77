"""Numbers in a wrong unit, or left out by an exporter, are told in one sentence."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from small_urdfs import LIMIT, box, chain, fingers, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.units import FAR, check_units, far_meshes

BASE = link("base", box("0.2 0.2 0.6", "0 0 0.3"))
NONE = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
ARM = chain("arm", 6, "base", first="0 0 0.6")
HAND = fingers("jaw", "arm5")


def units_of(tmp_path, *parts):
    return check_units(load_urdf(urdf_of(tmp_path, *parts)))


@pytest.mark.parametrize(("hand", "more"), [(HAND, 2), (HAND.replace(LIMIT, NONE), 4)])
def test_an_arm_whose_limits_an_exporter_left_out_is_refused(tmp_path, hand, more):
    path = urdf_of(tmp_path, BASE, ARM.replace(LIMIT, NONE), hand)
    with pytest.raises(RobotError) as caught:
        make_robot_folder(path, tmp_path / "mine")
    assert f"'arm0_joint', 'arm1_joint', 'arm2_joint', 'arm3_joint' and {more} more have" in str(
        caught.value
    )
    assert str(caught.value).endswith("give each its lower and upper limit, in rad or m")


def test_a_few_joints_that_cannot_move_beside_others_are_all_right(tmp_path):
    locked = chain("leg", 6, "base", first="0 0.2 0.3").replace(LIMIT, NONE)
    assert units_of(tmp_path, BASE, ARM, HAND, locked) == ()
    assert units_of(tmp_path, BASE, chain("arm", 3, "base").replace(LIMIT, NONE)) == ()


def test_limits_that_look_like_degrees_are_told_with_the_joints(tmp_path):
    def limits(end, count):
        wide = LIMIT.replace("-1", f"-{end}").replace('upper="1"', f'upper="{end}"')
        return ARM.replace(LIMIT, wide, count)

    (note,) = units_of(tmp_path, BASE, limits(180, 2))
    assert note.startswith("'arm0_joint', 'arm1_joint' have limits of up to 180 rad, which look")
    assert note.endswith("give them in rad (180 degrees are 3.1416 rad)")
    assert units_of(tmp_path, BASE, limits(180, 1)) == ()  # one, as of a base that turns
    assert units_of(tmp_path, BASE, limits(4 * math.pi, 6)) == ()
    assert units_of(tmp_path, BASE, limits(1e6, 6)) == ()  # where no limit is meant


def test_a_robot_in_millimetres_is_refused(tmp_path):
    path = urdf_of(tmp_path, BASE, chain("arm", 6, "base", at="0 0 100", first="0 0 600"))
    with pytest.raises(RobotError, match="'arm5' is 1100 m away from 'base', which looks"):
        make_robot_folder(path, tmp_path / "mine")


def test_meshes_in_millimetres_are_told():
    def mesh(name, size):
        fit = None if size is None else SimpleNamespace(corners=np.array([[0, 0, 0], [0, size, 1]]))
        return SimpleNamespace(link=name, fit=fit)

    meshes = [mesh("a", FAR), mesh("b", 180.0), mesh("c", None), mesh("d", 90.0)]
    (note,) = far_meshes(meshes)
    assert note.startswith("the meshes of 'b', 'd' are up to 180 m large, which looks like milli")
    assert far_meshes(meshes[::2]) == ()
