"""What a URDF leaves out of solid bodies, and what is made up for it."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_urdfs import box, chain, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.urdf import Urdf, checked_urdf, read_urdf
from cgtorch.tabletop.robot_folder.solid import (
    DENSITY,
    SMALL,
    _unbalanced,
    solid,
    solid_arms,
    sound_inertials,
)
from cgtorch.tabletop.robot_folder.structure import Structure


def inertial(mass: float, moments: tuple[float, ...] = (0.1, 0.1, 0.1)) -> str:
    named = " ".join(f'{n}="{x}"' for n, x in zip(("ixx", "iyy", "izz"), moments, strict=True))
    return f'<inertial><mass value="{mass}"/><inertia {named} ixy="0" ixz="0" iyz="0"/></inertial>'


def urdf_with(tmp_path: Path, *parts: str) -> Urdf:
    """Of which no inertia is checked."""
    path = urdf_of(tmp_path, *parts)
    return checked_urdf(path, read_urdf(path))


BASE = link("base", box("0.3 0.3 1", "0 0 0.5"))


def test_a_moving_link_without_mass_gets_that_of_a_box_around_it(tmp_path: Path) -> None:
    parts = (
        BASE, link("a", box("0.2 0.4 0.6", "1 2 3")), joint("a", "base"), link("b", ""),
        joint("b", "base"), link("c") + joint("c", "base"), link("d", inertial(2.0)),
        joint("d", "c", kind="fixed", more=""), link("e"),
        joint("e", "base", kind="fixed", more=""),
    )  # fmt: skip
    found, names = sound_inertials(urdf_with(tmp_path, *parts))
    assert names == ("a", "b")  # as c has the mass of what is fixed to it, and e does not move
    links = found.model.link_map
    made = links["a"].inertial
    mass = DENSITY * 0.2 * 0.4 * 0.6
    assert made.mass == pytest.approx(mass)
    assert made.origin[:3, 3] == pytest.approx([1, 2, 3])
    moments = [mass / 12 * (x**2 + y**2) for x, y in ((0.4, 0.6), (0.2, 0.6), (0.2, 0.4))]
    assert made.inertia == pytest.approx(np.diag(moments))
    bare = links["b"].inertial
    assert bare.mass == pytest.approx(DENSITY * SMALL**3)
    assert bare.origin[:3, 3] == pytest.approx([0, 0, 0])
    assert bare.inertia == pytest.approx(np.eye(3) * bare.mass * SMALL**2 / 6)
    assert [links[name].inertial for name in ("base", "c", "e")] == [None] * 3


def test_an_impossible_inertia_is_replaced_and_its_mass_kept(tmp_path: Path) -> None:
    odd, negative = inertial(3.0, (1.0, 1.0, 2.1)), inertial(-1.0)
    parts = (
        link("base", box("0.3 0.3 1") + odd), link("a", box("0.2 0.4 0.6") + negative),
        joint("a", "base"), link("b", inertial(1.0)), joint("b", "a"),
    )  # fmt: skip
    found, names = sound_inertials(urdf_with(tmp_path, *parts))
    assert names == ("base", "a")
    links = found.model.link_map
    assert links["base"].inertial.mass == 3.0
    assert links["base"].inertial.inertia[2, 2] == pytest.approx(3.0 / 12 * (0.3**2 + 0.3**2))
    assert links["a"].inertial.mass == pytest.approx(DENSITY * 0.2 * 0.4 * 0.6)
    assert links["b"].inertial.inertia[0, 0] == 0.1
    assert found.xml.count(b"<inertial>") == 3
    again = sound_inertials(found)
    assert again == (found, ())
    assert again[0] is found


def test_a_moment_is_no_more_than_the_sum_of_the_others() -> None:
    def unbalanced(*moments: float) -> bool:
        return _unbalanced(SimpleNamespace(inertial=SimpleNamespace(inertia=np.diag(moments))))

    assert not unbalanced(1.0, 1.0, 2.01)
    assert unbalanced(1.0, 1.0, 2.03)
    assert unbalanced(0.5, 2.03, 1.5)
    assert not unbalanced(0.0, 0.0, 0.0)
    assert not _unbalanced(SimpleNamespace(inertial=None))
    assert not _unbalanced(SimpleNamespace(inertial=SimpleNamespace(inertia=None)))


def test_moments_of_a_wrong_unit_are_replaced(tmp_path: Path) -> None:
    """Those of a mass that would be far outside the shapes of its link, or beyond all bounds."""
    within = 0.1**2 + 0.2**2 + 0.3**2
    moments = {"a": 990 * within, "b": 1010 * within, "c": 3e6, "d": 1e5}
    parts = [
        link(name, ("" if name == "d" else box("0.2 0.4 0.6")) + inertial(1.0, (x, x, x)))
        + joint(name, "base")
        for name, x in moments.items()
    ]
    urdf = urdf_with(tmp_path, BASE, *parts)
    found, names = sound_inertials(urdf)
    assert names == ("b", "c")
    for name in names:
        assert found.link(name).inertial.mass == 1.0
        moment = found.link(name).inertial.inertia[0, 0]
        assert moment == pytest.approx(1 / 12 * (0.4**2 + 0.6**2))
    with pytest.raises(
        RobotError, match=r"'c' has an inertia of 3e\+06 kg m² .* above 1e\+06: cor"
    ):
        load_urdf(urdf.path)


def test_moments_are_far_out_by_where_a_mass_is_and_not_without_one(tmp_path: Path) -> None:
    within = 0.1**2 + 0.2**2 + 0.3**2
    beside, bare = inertial(1.0, (1010 * within,) * 3), "<inertial><mass value='1'/></inertial>"
    beside = beside.replace("<mass", '<origin xyz="1 0 0"/><mass')
    shape, fixed = box("0.2 0.4 0.6"), {"kind": "fixed", "more": ""}
    parts = (
        link("a", box("0.2 0.4 0.6", "1 0 0") + beside) + joint("a", "base"),
        link("b", shape + inertial(0.0)) + joint("b", "a", **fixed),
        link("c", shape + bare) + joint("c", "base"),
    )
    assert sound_inertials(urdf_with(tmp_path, BASE, *parts))[1] == ("a",)


SEEN = box("0.1 0.2 0.3", "1 2 3", "visual")


def test_what_is_seen_collides_where_nothing_else_does(tmp_path: Path) -> None:
    seen = link("base", SEEN) + link("a", SEEN + SEEN) + joint("a", "base") + link("b", "")
    urdf = load_urdf(urdf_of(tmp_path, seen, joint("b", "a")))
    found, (note,) = solid(urdf)
    assert note.startswith("the URDF has no collision shapes")
    counts = {name: len(each.collisions) for name, each in found.model.link_map.items()}
    assert counts == {"base": 1, "a": 2, "b": 0}
    (shape,) = found.link("base").collisions
    assert tuple(shape.geometry.box.size) == (0.1, 0.2, 0.3)
    assert shape.origin[:3, 3].tolist() == [1, 2, 3]
    for kept in (link("base", SEEN + box()), link("base", "")):
        urdf = load_urdf(urdf_of(tmp_path, kept))
        assert solid(urdf) == (urdf, ())


def test_arms_of_which_nothing_collides_collide_as_they_are_seen(tmp_path: Path) -> None:
    """Not those of which some part does, nor what belongs to no arm."""
    parts = (
        link("base", SEEN + box()), link("sign", SEEN), joint("sign", "base"),
        chain("a", 2, "base", shapes=SEEN), chain("b", 2, "base"), link("tip", SEEN),
        joint("tip", "b1"), link("bare", ""), joint("bare", "a1"),
    )  # fmt: skip
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    structure, notes = Structure(urdf, "base"), list[str]()
    chains = [[urdf.joint(f"{name}0_joint"), urdf.joint(f"{name}1_joint")] for name in "ab"]
    found = solid_arms(structure, chains, ["a1", "tip"], notes)
    counts = {name: len(each.collisions) for name, each in found.model.link_map.items()}
    assert counts["sign"] == counts["bare"] == 0
    assert counts["a0"] == counts["b0"] == counts["b1"] == counts["tip"] == 1
    assert notes == ["a0, a1, tip have no collision shapes, so that their visual ones are taken"]
    assert solid_arms(structure, chains[1:], ["b1"], notes) is urdf
    assert len(notes) == 1


def test_a_camera_or_gripper_that_collides_leaves_its_arm_as_it_is_seen(tmp_path: Path) -> None:
    """Unless such things are fixed to half of its bodies, or a link of its own collides."""
    parts = (
        BASE, chain("a", 4, "base", shapes=SEEN), link("camera"),
        joint("camera", "a1", kind="fixed", more=""),
    )  # fmt: skip

    def arm_of(*more: str) -> tuple[Urdf, Urdf, list[str]]:
        urdf = load_urdf(urdf_of(tmp_path, *parts, *more))
        notes = list[str]()
        chain = [urdf.joint(f"a{i}_joint") for i in range(4)]
        return solid_arms(Structure(urdf, "base"), [chain], ["a3"], notes), urdf, notes

    found, _, notes = arm_of()
    assert [len(found.link(f"a{i}").collisions) for i in range(4)] == [1] * 4
    assert len(found.link("camera").collisions) == 1
    assert notes == ["a0, a1, a2, a3 have no collision shapes, so that their visual ones are taken"]
    found, urdf, _ = arm_of(link("gripper") + joint("gripper", "a3", kind="fixed", more=""))
    assert found is urdf
    parts = (BASE, chain("a", 3, "base", shapes=SEEN), link("a3"), joint("a3", "a2"))
    found, urdf, _ = arm_of()
    assert found is urdf
