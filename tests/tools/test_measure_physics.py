"""Poses that are accepted are lifted, refused ones are not; a figure is made of what is kept."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("mujoco")

import measure_physics
from in_physics import poses, skills
from in_physics.tried import Rows, Sizes, Tried
from make_figures import markdown

from cgtorch.tabletop.kinematics.grasping import within_reach

SMALL = Sizes(4, range(1))


def test_poses_are_as_they_are_asked_for() -> None:
    domain = poses.without_noise("pr2")
    for possible in (True, False):
        chosen = poses.poses(domain, 5, possible)
        percept, graspable = poses.label(poses.Scenes(domain.world), chosen)
        assert graspable.tolist() == [possible] * 5
        assert bool(within_reach(domain.robot, percept[:, 4:7]).all())


def test_accepted_poses_are_lifted_and_others_hardly(tmp_path: Path) -> None:
    ((_, measured),) = poses.accepted(tmp_path, Sizes(12, range(1)))
    row = measured()
    assert row.tried == 12
    assert 11 <= row.strict <= row.lifted
    ((_, measured),) = poses.refused(tmp_path, Sizes(10, range(1)))
    row = measured()
    assert row.tried == 3
    assert row.strict <= row.lifted <= 1


def test_an_object_far_wider_than_the_hand_is_not_lifted() -> None:
    domain = poses.without_noise("pr2")
    chosen, wide = poses.poses(domain, 3, True), poses.Thing(size=(0.08, 0.05))
    assert poses.carried_out(domain, wide, chosen, "wide", "–").lifted == 0


def test_a_skill_is_tried_as_often_as_asked() -> None:
    run = Path(__file__).resolve().parents[2] / "runs" / "reference"
    found = [measured() for _, measured in skills.everywhere(run, SMALL, 0, "S3", "a", "b")]
    assert [row.about for row in found] == [
        f"S3: {kind}" for kind in ("perimeter", "near", "left", "right", "far")
    ]
    assert [row.tried for row in found] == [4, 1, 1, 1, 1]
    assert all(row.strict <= row.lifted <= row.tried for row in found)


def test_what_is_kept_is_not_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def measured() -> Tried:
        calls.append(1)
        return Tried("this", 1000, 999, 998, "99 %")

    def part(folder: Path, sizes: Sizes) -> Rows:
        yield "this", measured

    monkeypatch.setattr(measure_physics, "PARTS", {"poses": part})
    file = tmp_path / "figure.json"
    for _ in range(2):
        done = CliRunner().invoke(
            measure_physics.command, [str(tmp_path / "kept"), "--figure", str(file)]
        )
        assert done.exit_code == 0, done.output
    assert calls == [1]
    figure = json.loads(file.read_text())
    assert figure["rows"] == [["this", "999 / 1,000", "998 / 1,000", "99 %"]]
    assert "| this | 999 / 1,000 |" in markdown(figure, {})
