"""Rounds with a learned model with rewards: what is stored, goes on, and is refused."""

from contextlib import nullcontext
from math import inf
from pathlib import Path
from typing import Any

import pytest
import torch
from rewarded_cart import RewardedCart

from cgtorch.domains.models import Models
from cgtorch.domains.rewarded_models import Known
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.improvement.events import Event
from cgtorch.improvement.setup import Setup
from cgtorch.runs.log import read_log
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, planned_run, write_run
from cgtorch.training.auto import reached, train_until
from cgtorch.training.context import Training


class WithoutModels(RewardedCart):
    models = None


class WithUsualModels(RewardedCart):
    models = Models


def planned(folder: Path, domain: RewardedCart, **settings: Any) -> StoredRun:
    small = {"population": 16, "generations": 40, "attempts": 1, "max_transitions": 500, **settings}
    name = f"rewarded_cart:{type(domain).__name__}"
    return planned_run(folder, RunSettings(domain=name, **small), domain=domain)


def trained(run: StoredRun, goal: Goal) -> list[dict[str, Any]]:
    def quietly(message: str) -> nullcontext[None]:
        return nullcontext()

    def watch(event: Event) -> None:
        pass

    return train_until(Training(run, watch, quietly), goal)


def test_a_goal_is_reached_and_steps_in_the_world_are_stored(tmp_path: Path) -> None:
    run = planned(tmp_path / "run", RewardedCart())
    assert (run.imagines, run.learns) == (True, False)
    write_run(run)
    goal = Goal(target=8.0, rounds=2)
    results = trained(run, goal)
    assert reached(goal, results)
    asked = results[-1]["asked"]
    steps = sum(each["motions"] for each in asked.values())
    assert 0 < steps < 400
    assert asked["starts"]["looks"] > 0
    assert any(row["event"] == "played" for row in read_log(run.folder))
    known = load_progress(run, run.folder / "auto-1").knowledge
    assert isinstance(known, Known)
    assert len(known.steps) == steps
    same = run.reward_models.recalled(known.tensors())
    p, u = torch.zeros(1, 2).double(), torch.ones(1, 1).double()
    assert torch.equal(same.gamma.predict(p, u)[0], known.gamma.predict(p, u)[0])
    (run.folder / "auto-1" / "known.safetensors").write_bytes(b"none")
    with pytest.raises(RunError, match="known"):
        load_progress(run, run.folder / "auto-1")


@pytest.mark.parametrize(("target", "aim"), [(3.0, 3.0), (inf, RewardedCart.target_return)])
def test_a_search_aims_at_the_goal_or_at_the_domains_target(
    target: float, aim: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class AskedError(Exception):
        """The search has been called."""

    def search(setup: Setup[Any], *about: object) -> None:
        raise AskedError(setup.budget.satisfied)

    monkeypatch.setattr("cgtorch.training.train.improve_imagined", search)
    run = planned(tmp_path / "run", RewardedCart())
    write_run(run)
    goal = Goal(rounds=1)
    object.__setattr__(goal, "target", target)  # as a stage has no goal, and a goal is finite
    with pytest.raises(AskedError) as found:
        trained(run, goal)
    assert found.value.args == (aim,)


def test_damaged_steps_are_refused(tmp_path: Path) -> None:
    run = planned(tmp_path / "run", RewardedCart())
    with pytest.raises(RunError, match="steps in the world are damaged"):
        run.reward_models.recalled({"percept": torch.zeros(3, 2)})


@pytest.mark.parametrize(
    ("domain", "settings", "message"),
    [
        (WithUsualModels(), {}, "models 'learned'"),
        (RewardedCart(), {"method": "paper"}, "method 'paper'"),
        (RewardedCart(), {"data": ("some.csv",)}, "logged data"),
    ],
)
def test_what_does_not_go_together_is_refused(
    domain: RewardedCart, settings: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingsError, match=message):
        planned(tmp_path / "run", domain, **settings)


@pytest.mark.parametrize("domain", [WithoutModels(), WithUsualModels()])
def test_models_are_learned_of_any_domain_with_rewards(
    domain: RewardedCart, tmp_path: Path
) -> None:
    run = planned(tmp_path / "run", domain, models="learned")
    assert run.imagines
    assert run.reward_models.most_steps == float("inf")
