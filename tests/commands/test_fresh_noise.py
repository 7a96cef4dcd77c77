"""`cgtorch-train --noise fresh`: a world as a robot's, in which nothing can be tried again."""

from pathlib import Path
from typing import Any

import pytest
import torch
from command_line import TRAIN, Shell, as_options
from support import create_run
from told_by_runs import logged, result_of
from torch import Tensor
from trained import SMALL

from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import read_run
from cgtorch.simulation import Recording
from cgtorch.tabletop.settings import TabletopSettings

OPTIONS = [*as_options(SMALL), "--noise=fresh", "--attempts=12"]


class Met:
    """The placements of what was asked of the world, but for looks and for tests in a report."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.places = list[tuple[float, ...]]()
        start = Recording.start

        def noted(recording: Recording, scenario: Tensor) -> tuple[Tensor, Tensor]:
            world: Any = recording.environment
            scenes = world.scenarios[scenario]
            if recording.phase in ("exploration", "practice"):
                self.places += map(tuple, torch.cat([scenes.pose, scenes.object], 1).tolist())
            return start(recording, scenario)

        monkeypatch.setattr(Recording, "start", noted)


def summed(asked: dict[str, dict[str, int]], name: str) -> int:
    return sum(phase[name] for phase in asked.values())


@pytest.mark.hostile
def test_rounds_end_with_a_skill_that_has_met_each_placement_once(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    met = Met(monkeypatch)
    words = ["--stage", "auto", "--rounds", 1, "--run-dir", "run", *OPTIONS]
    ended = shell.does(TRAIN, *words)
    assert len(met.places) == len(set(met.places))
    result, run = result_of(tmp_path / "run", "auto-1"), read_run(tmp_path / "run")
    assert [result[name] for name in ("fresh", "overall", "decisive")] == [None] * 3
    assert result["practice"] == SMALL.practice
    goal = "has reached" if result["in_a_row"] >= SMALL.practice else "has not reached"
    assert f"run run {goal} its goal of 0.99" in ended.err
    assert logged(run.folder, "ended")[-1]["reached"] == ("not" not in goal)
    progress = load_progress(run, run.folder / "auto-1")
    assert progress.skill is not None
    asked = result["asked"]
    assert set(asked) == {"exploration", "looks", "practice"}  # nothing of W is tried again
    assert len(progress.solved) + len(progress.missed) == asked["practice"]["episodes"]
    looked = asked["practice"]["looks"] + asked["exploration"]["looks"]
    assert asked["practice"]["looks"] == asked["practice"]["episodes"]
    assert len(met.places) == looked
    assert "asked of the world: {motions} motions, {tests} tests, ".format(
        motions=summed(asked, "motions"), tests=summed(asked, "tests")
    ) in ended.err  # fmt: skip
    (entry,) = logged(run.folder, "accepted")
    assert entry["w_other_noise"] is None
    lines = [line.split() for line in ended.out.splitlines()]
    (row,) = (line for line in lines if line[:1] == ["auto-1"])
    assert row[:2] == ["auto-1", "perimeter"]
    assert row[4:6] == ["0/0", "–"]  # W kept, and no test on fresh scenarios
    assert "auto-1 on perimeter" not in ended.out


@pytest.mark.hostile
def test_a_stage_tries_its_tests_once_and_goes_on(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    met = Met(monkeypatch)
    shell.does(TRAIN, "--stage", "S0", "--run-dir", "run", *OPTIONS)
    run = read_run(tmp_path / "run")
    assert not run.repeats
    tests = run.domain.tests("near")
    own = list(map(tuple, torch.cat([tests.pose, tests.object], 1).tolist()))
    result, asked = result_of(run.folder, "S0"), result_of(run.folder, "S0")["asked"]
    assert len(met.places) == len(set(met.places))
    assert len(met.places) == asked["practice"]["looks"] + asked["exploration"]["looks"]
    assert len(set(own) & set(met.places)) >= result["targets_succeeded"] > 0
    assert (result["targets"], result["earlier_failures"]) == (5, 0)
    assert "trials" not in asked
    for test in ("fresh", "overall"):  # which a report shows, and no robot is asked for
        assert result[test]["tried"] == 40


def test_a_world_under_fresh_noise_cannot_be_made_one_that_repeats(
    shell: Shell, tmp_path: Path
) -> None:
    create_run(tmp_path / "run", SMALL, TabletopSettings(noise="fresh"))
    message = shell.refuses(TRAIN, "--resume", "run", "--override", "noise=seeded")
    assert "noise fresh of run 'run' cannot become seeded" in message
    assert "noise is 'none'; use one of seeded, fresh" in shell.refuses(
        TRAIN, "--run-dir", "other", "--noise", "none"
    )
    assert not (tmp_path / "other").exists()
