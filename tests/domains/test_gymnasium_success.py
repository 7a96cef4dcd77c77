"""Gymnasium environments in which the info of a step tells of success."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from support import seeded

import cgtorch
from cgtorch.domains.check import check_domain
from cgtorch.domains.domain import rewarded
from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import MOST_UNSOLVED, Success
from cgtorch.domains.registry import make_domain
from cgtorch.evolution.population import random_population
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.ground.errors import DomainError, SettingsError, WorldError
from cgtorch.simulation import rollout

gymnasium = pytest.importorskip("gymnasium")
from tiny_worlds import GOAL, ZOO  # noqa: E402


def domain_of(**settings: Any) -> Gymnasium:
    made = make_domain(f"gymnasium:{GOAL}", GymnasiumSettings(**settings))
    assert isinstance(made, Gymnasium)
    return made


def remarks_of(domain: Gymnasium) -> list[str]:
    return domain.pictures(domain).remarks()


def started(domain: Gymnasium, count: int) -> tuple[Any, Lanes]:
    world: Any = domain.world(domain.draw("starts", count, seeded(0)))
    return world, start_lanes(world, torch.arange(count), world.control_size, 0)


def to_the_goal(domain: Gymnasium, lanes: Lanes) -> torch.Tensor:
    """The controls that move each point to its goal as fast as it can."""
    names = [field.name for field in domain.percept]
    scaling = domain.known.scaling
    seen = lanes.percept * scaling.scale + scaling.centre
    place, goal = (names.index(f"{name}_goal 1") for name in ("achieved", "desired"))
    way = seen[:, goal : goal + 2] - seen[:, place : place + 2]
    return (way / 0.5).clamp(-1, 1).float()


def test_success_is_that_of_the_info_and_ends_an_episode() -> None:
    domain = domain_of(success="is_success")
    assert not rewarded(domain)
    check_domain(domain, "starts")
    world, lanes = started(domain, 6)
    assert (world.success(lanes)[1] == 0).all()
    for _ in range(11):
        lanes, _ = world.step(lanes, to_the_goal(domain, lanes))
        assert torch.equal(world.over(lanes), world.success(lanes)[1] == 1)
    assert world.over(lanes).all()
    still, done = world.step(lanes, torch.ones(6, 2))
    assert not done.any()
    assert torch.equal(still.state, lanes.state)


def test_success_at_the_last_step_can_be_lost() -> None:
    domain = domain_of(success="is_success", success_at="last")
    world, lanes = started(domain, 6)
    for _ in range(8):
        lanes, _ = world.step(lanes, to_the_goal(domain, lanes))
    assert (world.success(lanes)[1] == 1).all()
    for _ in range(4):
        assert not world.over(lanes).any()
        lanes, done = world.step(lanes, torch.ones(6, 2))
        assert done.all()
    assert world.over(lanes).all()
    assert (world.success(lanes)[1] < 0.5).any()
    with pytest.raises(SettingsError, match="success_at is 'end'; use one of any, last"):
        GymnasiumSettings(success_at="end")


def test_the_best_reward_so_far_grades_what_has_not_succeeded() -> None:
    domain = domain_of(success="is_success")
    world, lanes = started(domain, 40)
    away, _ = world.step(lanes, -to_the_goal(domain, lanes))
    near, _ = world.step(lanes, 0.3 * to_the_goal(domain, lanes))
    far, close = (world.success(one)[1] for one in (away, near))
    missed = close < 0.5
    assert missed.sum() > 0
    assert (far[missed] < close[missed]).all()
    assert (far[far < 0.5] > 0).all()
    assert (close[missed] <= MOST_UNSOLVED).all()
    back, _ = world.step(near, -to_the_goal(domain, near))
    assert torch.equal(world.success(back)[1][missed], close[missed])


def test_rollouts_end_with_success_or_with_the_episode() -> None:
    domain = domain_of(success="is_success")
    graphs = random_population(400, domain.actions(), 8, (2, 6), seeded(0)).graphs
    world: Any = domain.world(domain.draw("starts", 4, seeded(1)))
    one, two = (rollout(graphs, domain.actions(), world, max_transitions=10**5) for _ in range(2))
    assert one.returns is None
    assert 0 < one.succeeded.sum() < one.succeeded.numel()
    assert torch.equal(one.percept, two.percept)
    assert one.executed < 400 * 4 * 100
    step = domain.actions().index("Step")
    acts = (graphs.action == step).any(1)
    assert (one.transitions[one.succeeded] <= 12 * 6).all()
    assert not one.succeeded[~acts].any()


def test_success_is_found_where_nothing_else_is_given() -> None:
    domain = domain_of()
    assert domain.known.success is not None
    assert domain.known.success.name == "is_success"
    assert remarks_of(domain)[0] == "An episode is solved by is_success in the info of a step."
    about = dict(domain.pictures(domain).about())
    assert about["Solved by"] == "is_success in the info, at any step"
    assert rewarded(domain_of(target_return=-3.0))  # a target is of returns
    with pytest.raises(DomainError, match=r"no return .* \(--target\), or .* as success \(--succ"):
        domain_of(env={"says": "done"})


def test_a_name_that_random_episodes_do_not_show_is_told() -> None:
    with pytest.raises(DomainError, match=r"success is 'is_sucess', .* \(--success is_success\)"):
        domain_of(success="is_sucess")
    silent: Any = make_domain(f"gymnasium:{ZOO}", GymnasiumSettings(success="won"))
    assert remarks_of(silent) == ["No info of 20 random episodes has won, as infos were empty."]
    assert silent.known.success.spread == 1  # of rewards that are always 1


def test_a_test_may_end_what_a_success_ends() -> None:
    assert "Test" in domain_of(success="is_success").actions().names
    assert "Test" not in domain_of(success="is_success", success_at="last").actions().names
    assert "Test" not in domain_of(target_return=-3.0).actions().names


def test_the_target_in_python_is_a_share(tmp_path: Path) -> None:
    own = {"percepts": ("achieved_goal",), "env": {"speed": 0.9}, "success": "is_success"}
    name = f"gymnasium:{GOAL}"
    made = cgtorch.make(name, **own)
    for folder, domain, settings in (("one", name, own), ("two", made, {})):
        about: Any = {"target": 0.6, "quiet": True, "watch": lambda event: True, **settings}
        run = cgtorch.train(domain, tmp_path / folder, **about)
        assert run.settings.domain == name
        assert run.domain.settings == made.settings
        assert '"target": 0.6' in (run.folder / "run.json").read_text()


def test_success_that_is_no_number() -> None:
    domain = domain_of(success="is_success", env={"value": "near"})
    world, lanes = started(domain, 2)
    with pytest.raises(WorldError, match=r"has is_success 'near'; name .* \(--success\)"):
        world.step(lanes, torch.zeros(2, 2))


def test_it_is_kept_with_a_run(tmp_path: Path) -> None:
    domain = domain_of(success_at="last")
    domain.files(domain).write(tmp_path)
    again = Gymnasium.files.read(Gymnasium, domain.settings, tmp_path)
    assert again.known.success == domain.known.success
    assert again.known.success is not None
    assert again.known.success.at_last
    assert remarks_of(again) == remarks_of(domain)
    assert domain.files(domain).options(tmp_path) == {"success": "is_success"}
    stored = json.loads((tmp_path / "gymnasium.json").read_text())
    for wrong in ({"spread": 0}, {"mean": "a"}, {"colour": 1}):
        changed = {**stored, "success": stored["success"] | wrong}
        (tmp_path / "gymnasium.json").write_text(json.dumps(changed))
        with pytest.raises(DomainError, match="damaged"):
            Gymnasium.files.read(Gymnasium, domain.settings, tmp_path)


def test_more_lanes_than_environments_share_them(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = domain_of(success="is_success")
    monkeypatch.setattr("cgtorch.domains.gymnasium_episodes.MOST", 3)
    few = domain_of(success="is_success")
    (world, lanes), (scarce, others) = started(domain, 8), started(few, 8)
    for seed in range(4):
        control = 2 * torch.rand(8, 2, generator=seeded(seed)) - 1
        (lanes, _), (others, _) = world.step(lanes, control), scarce.step(others, control)
        assert torch.equal(lanes.percept, others.percept)
    assert len(few.episodes._having) == 3
    assert np.isfinite(others.percept.numpy()).all()


@pytest.mark.parametrize(
    ("told", "wanted"),
    [(True, True), (0.4, False), (np.array([1.0]), True), (np.array([[False]]), False)],
)
def test_success_is_a_number_or_an_array_of_one(told: object, wanted: bool) -> None:
    about: Any = SimpleNamespace(where="step 3")
    assert Success("done").seen({"done": told}, about) is wanted


@pytest.mark.parametrize("told", [None, "yes", np.array([1.0, 0.0]), float("nan"), np.zeros(0), {}])
def test_success_that_is_no_number_is_refused(told: object) -> None:
    about: Any = SimpleNamespace(where="step 3")
    with pytest.raises(WorldError, match=r"the info of step 3 has done .*; name something in it"):
        Success("done").seen({"done": told}, about)
