"""What a run is begun with: its domain, with settings of its own, and its kind of scenarios."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support import create_run
from trained import SMALL, Trained, copied

from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.runs.chosen import stored_domain
from cgtorch.runs.stored_run import planned_run, read_run, write_run
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
