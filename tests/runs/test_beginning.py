"""What a run is begun with: its domain, with settings of its own, and its kind of scenarios."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rewarded_cart import RewardedCart
from support import create_run
from trained import SMALL, Trained, copied

from cgtorch import DomainSettings
from cgtorch.ground.errors import ActionError, DomainError, RunError, SettingsError
from cgtorch.runs import stored_run
from cgtorch.runs.chosen import stored_domain
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import only_begun, planned_run, read_run, write_run
from cgtorch.runs.writer import WRITER
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.settings import TabletopSettings


def listing(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_a_run_keeps_the_settings_of_its_domain(tmp_path: Path) -> None:
    own = TabletopSettings(robot="fetch", position_noise=0, percept="yaw", networks="percept")
    run = create_run(tmp_path / "run", SMALL, own)
    for one in (run, read_run(run.folder)):
        assert one.domain.settings == own
        assert isinstance(one.domain, Tabletop)
        assert one.domain.robot.description.name == "Fetch"
        assert (one.domain.tabletop, one.domain.networks) == ("yaw", "percept")
        assert len(one.domain.percept) == 9
        assert one.all_settings()["position_noise"] == 0
        assert one.all_settings()["seed"] == SMALL.seed
    data = json.loads((run.folder / "run.json").read_text())
    assert data["domain_settings"] == vars(own)
    assert data["settings"]["domain"] == "tabletop"


def test_a_planned_run_is_one_that_is_not_written(tmp_path: Path) -> None:
    run = planned_run(tmp_path / "runs" / "one", SMALL)
    assert listing(tmp_path) == set()
    write_run(run)
    assert read_run(run.folder).settings == run.settings


@pytest.mark.parametrize("kind", ["", "moon", "general-clutte"])
def test_scenarios_that_no_run_is_about(tmp_path: Path, kind: str) -> None:
    says = f"scenarios is '{kind}'; use one of perimeter, near, left, right, far, general"
    with pytest.raises(SettingsError, match=says):
        create_run(tmp_path / "run", replace(SMALL, scenarios=kind))
    assert listing(tmp_path) == set()


def test_the_domain_of_a_folder(trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "run")
    for place in (folder, folder / "S0"):
        assert stored_domain(place) == "tabletop"
    assert stored_domain(tmp_path) is None
    (folder / "run.json").write_text("{}")
    with pytest.raises(RunError, match="is not of a cgtorch run"):
        stored_domain(folder)


def test_in_a_world_that_does_not_repeat_itself_a_run_is_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each rank would meet another one, and several would move one robot."""
    monkeypatch.setattr("cgtorch.ground.distributed.count", lambda: 2)
    planned_run(tmp_path / "seeded", SMALL)
    with pytest.raises(SettingsError, match="which 2 processes cannot share; train with one"):
        planned_run(tmp_path / "fresh", SMALL, TabletopSettings(noise="fresh"))
    driven = replace(SMALL, driver="no_such_package:Robot")
    with pytest.raises(SettingsError, match="which 2 processes cannot share; train with one"):
        planned_run(tmp_path / "robot", driven)  # before anything moves


BROKEN = """
from cgtorch.tabletop.actions import Detect

class Broken(Detect):
    def forward(self, lanes, parameters, environment):
        return lanes
"""


def test_actions_are_tried_unless_the_library_made_them_and_the_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_action.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(tmp_path)
    tried, check = list[str](), stored_run.check_action

    def watched(name: str, action: Any, world: Any) -> None:
        tried.append(name)
        check(name, action, world)

    monkeypatch.setattr(stored_run, "check_action", watched)
    planned_run(tmp_path / "run", SMALL)
    assert tried == []
    with pytest.raises(ActionError, match=r"'Broken': forward returned a Lanes; return"):
        planned_run(tmp_path / "run", replace(SMALL, actions=("broken_action:Broken",)))
    assert tried == ["Broken"]
    tried.clear()
    cart = RewardedCart(DomainSettings())
    run = planned_run(tmp_path / "run", RunSettings(domain="mine:Cart", models="none"), domain=cart)
    assert tried == list(run.actions.names)


def test_a_run_does_not_replace_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    full = tmp_path / "full"
    full.mkdir()
    (full / "other").touch()
    with pytest.raises(RunError, match="is no run but a file; choose another"):
        planned_run(tmp_path / "file", SMALL)
    with pytest.raises(RunError, match="is not empty and holds no run; choose another folder"):
        planned_run(full, SMALL)
    planned_run(full, SMALL, anew=True)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunError, match="a run cannot replace the current folder"):
        planned_run(tmp_path, SMALL, anew=True)


def test_a_run_that_has_produced_nothing_may_begin_again(tmp_path: Path) -> None:
    settings = RunSettings(domain="rewarded_cart:RewardedCart", models="none")
    cart, folder = RewardedCart(DomainSettings()), tmp_path / "run"
    write_run(run := planned_run(folder, settings, domain=cart))
    (folder / "events.out.tfevents.1").touch()
    (folder / WRITER).touch()
    assert only_begun(run)
    write_run(planned_run(folder, replace(settings, seed=5), anew=True, domain=cart), anew=True)
    assert read_run(folder, domain=cart).settings.seed == 5
    (folder / "log.jsonl").touch()
    assert not only_begun(run)


def test_of_two_that_begin_a_run_at_once_the_second_changes_nothing(tmp_path: Path) -> None:
    cart, folder = RewardedCart(DomainSettings()), tmp_path / "run"
    one, other = (
        planned_run(
            folder,
            RunSettings(domain="rewarded_cart:RewardedCart", models="none", seed=seed),
            domain=cart,
        )
        for seed in (1, 2)
    )
    write_run(one)
    with pytest.raises(RunError, match=r"cannot write .*run'"):
        write_run(other)
    assert read_run(folder, domain=cart).settings.seed == 1


def test_a_tabletop_that_has_produced_nothing_may_begin_with_another_robot(tmp_path: Path) -> None:
    write_run(run := planned_run(folder := tmp_path / "run", SMALL))
    assert only_begun(run)
    write_run(planned_run(folder, SMALL, TabletopSettings(robot="fetch"), anew=True), anew=True)
    assert "fetch" in (folder / "robot" / "robot.urdf").read_text().lower()
    (folder / "start").mkdir()
    assert not only_begun(run)


def test_a_run_is_opened_with_what_it_was_begun_with(trained: Trained) -> None:
    for given, error, says in (
        ({"domain": "mine:Own"}, DomainError, "is about domain 'tabletop', not 'mine:Own'; give"),
        ({"trusted": ("a:B",)}, ActionError, "was begun without action 'a:B' and cannot use it"),
        ({"driver": "a:B"}, DomainError, "was begun with no driver, not 'a:B'; give that"),
    ):
        with pytest.raises(error, match=says):
            read_run(trained.folder, **given)  # type: ignore[arg-type]
    run = read_run(trained.folder, domain="tabletop")
    assert (run.learns, run.imagines, run.repeats, run.kind) == (True, False, True, "perimeter")
    assert len(run.like()) == 0
    assert [result["stage"] for result in run.results] == ["S0", "S1"]
    none = replace(run, settings=replace(run.settings, models="none"))
    assert (none.learns, none.imagines) == (False, False)
