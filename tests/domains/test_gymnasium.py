"""Gymnasium's environments as domains: what lanes do is what Gymnasium plays."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support import seeded

from cgtorch.domains.check import check_domain
from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_scaling import scaling_of
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import Played, PlayedWorld, VectorSteps
from cgtorch.domains.registry import make_domain
from cgtorch.evolution.population import random_population
from cgtorch.ground.environment import Bounded, Lanes, start_lanes
from cgtorch.ground.errors import DomainError, WorldError
from cgtorch.native.processes import in_processes
from cgtorch.simulation import rollout

gymnasium = pytest.importorskip("gymnasium")
IDS = ["CartPole-v1", "Pendulum-v1", "Acrobot-v1", "MountainCarContinuous-v0"]


def domain_of(name: str) -> Gymnasium:
    made = make_domain(f"gymnasium:{name}", GymnasiumSettings(target_return=-50.0))
    assert isinstance(made, Gymnasium)
    return made


def controls_of(domain: Gymnasium, steps: int, lanes: int) -> torch.Tensor:
    return 2 * torch.rand(steps, lanes, len(domain.control), generator=seeded(1)) - 1


def started(world: Any, count: int) -> Lanes:
    return start_lanes(world, torch.arange(count), world.control_size, 0)


@pytest.mark.parametrize("name", IDS)
def test_it_keeps_the_interface(name: str) -> None:
    check_domain(domain_of(name), "starts")


def test_the_hidden_layer_has_the_size_that_was_asked_for() -> None:
    settings = GymnasiumSettings(target_return=-50.0, hidden=20)
    actions = make_domain("gymnasium:Pendulum-v1", settings).actions()
    usual = domain_of("Pendulum-v1").actions()
    sizes = {
        each: (before.num_parameters, after.num_parameters)
        for each, before, after in zip(usual.names, usual.actions, actions.actions, strict=True)
        if before.num_parameters != after.num_parameters
    }
    assert sizes == {"Aim": (3 * 8 + 8 + 8 + 1, 3 * 20 + 20 + 20 + 1)}


@pytest.mark.parametrize("name", IDS)
def test_lanes_do_what_gymnasium_plays(name: str) -> None:
    domain = domain_of(name)
    starts = domain.draw("starts", 3, seeded(0))
    world, controls = domain.world(starts), controls_of(domain, 60, 3)
    lanes = started(world, 3)
    for control in controls:
        lanes, _ = world.step(lanes, control)
    for row, seed in enumerate(starts.seed.tolist()):
        plain = gymnasium.make(name)
        observation, _ = plain.reset(seed=seed)
        gained, over = 0.0, False
        for control in controls[:, row]:
            if over:
                break
            space = plain.action_space
            if hasattr(space, "low"):
                action: Any = control.numpy().clip(space.low, space.high)
            else:
                action = int(control.argmax())
            observation, reward, terminated, truncated, _ = plain.step(action)
            gained, over = gained + float(reward), terminated or truncated
        seen = torch.from_numpy(np.asarray(observation)).double() - domain.known.scaling.centre
        assert torch.allclose(
            lanes.percept[row].double(), seen / domain.known.scaling.scale, atol=1e-5
        )
        assert float(world.returns(lanes)[row]) == pytest.approx(gained, abs=1e-4)
        assert bool(world.over(lanes)[row]) == over


def test_the_vectorised_environment_is_used_and_is_the_same() -> None:
    domain = domain_of("CartPole-v1")
    assert domain.vector is not None
    starts = domain.draw("starts", 5, seeded(2))
    world: Any = domain.world(starts)
    played = PlayedWorld(domain.episodes, starts.seed, domain.known.scaling, target=-50.0)
    one, other = started(world, 5), started(played, 5)
    for control in controls_of(domain, 30, 5):
        (one, _), (other, _) = world.step(one, control), played.step(other, control)
        assert torch.allclose(one.percept, other.percept, atol=1e-6)
        assert torch.equal(world.over(one), played.over(other))
        assert torch.equal(world.returns(one), played.returns(other))


def test_others_have_no_vectorised_environment() -> None:
    with pytest.raises(LookupError, match="no vectorised environment"):
        VectorSteps("Acrobot-v1")


def test_a_lane_can_go_on_from_an_earlier_step_but_not_from_another_way() -> None:
    domain = domain_of("Pendulum-v1")
    world = domain.world(domain.draw("starts", 2, seeded(0)))
    first = started(world, 2)
    push, pull = torch.tensor([[1.0], [1.0]]), torch.tensor([[-1.0], [-1.0]])
    once, _ = world.step(first, push)
    twice, _ = world.step(once, push)
    again, _ = world.step(once, push)
    assert torch.equal(again.percept, twice.percept)
    world.step(first, pull)
    with pytest.raises(WorldError, match="has moved on"):
        world.step(twice, push)
    started(world, 2)
    with pytest.raises(WorldError, match="after other lanes have begun"):
        world.step(first, push)


def test_rollouts_are_repeatable_and_carry_returns() -> None:
    domain = domain_of("CartPole-v1")
    graphs = random_population(30, domain.actions(), 8, (2, 6), seeded(0)).graphs
    world = domain.world(domain.draw("starts", 4, seeded(1)))
    limit = {"max_transitions": 100_000}
    one, two = (rollout(graphs, domain.actions(), world, **limit) for _ in range(2))
    assert one.returns is not None
    assert two.returns is not None
    assert torch.equal(one.returns, two.returns)
    finished = one.returns.isfinite()
    assert 0 < finished.float().mean() < 1
    assert (one.returns[finished] >= 1).all()
    # An episode that nobody acts in has no return.
    assert (one.returns[~finished] == -torch.inf).all()
    assert not one.succeeded[~finished].any()


def test_many_lanes_run_in_parts_with_the_same_results(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = domain_of("Acrobot-v1")
    graphs = random_population(6, domain.actions(), 8, (2, 6), seeded(0)).graphs
    world = domain.world(domain.draw("starts", 5, seeded(1)))
    assert isinstance(world, Bounded)
    limit = {"max_transitions": 2000}
    whole = rollout(graphs, domain.actions(), world, **limit)
    for most in (12, 3):  # two graphs at once, and a part of the scenarios of one
        monkeypatch.setattr(Played, "most_lanes", most)
        found = rollout(graphs, domain.actions(), world, **limit)
        assert found.executed == whole.executed
        for name in ("succeeded", "timed_out", "percept", "transitions", "returns"):
            assert torch.equal(getattr(found, name), getattr(whole, name)), name


def test_the_target_is_the_environments_own_or_given() -> None:
    assert make_domain("gymnasium:CartPole-v1").target_return == 475.0
    with pytest.raises(
        DomainError, match=r"names no return from which it .*--target.* the folder of its run"
    ):
        make_domain("gymnasium:Pendulum-v1")
    assert domain_of("Pendulum-v1").target_return == -50.0


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("gymnasium", "names no environment"),
        ("gymnasium:os;system", "names no environment"),
        ("gymnasium:Nothing-v7", r"cannot make environment 'Nothing-v7'.* \(module:ENV_ID\)"),
    ],
)
def test_what_is_no_domain_is_told(name: str, reason: str) -> None:
    with pytest.raises(DomainError, match=reason):
        make_domain(name, GymnasiumSettings(target_return=0.0))


def test_percepts_have_the_spread_of_random_episodes() -> None:
    domain = domain_of("Acrobot-v1")  # whose velocities have bounds far from where it begins
    highest = gymnasium.make("Acrobot-v1").observation_space.high[4]
    assert domain.known.scaling.scale[4] < highest / 4
    seen = domain.episodes.explored(20, 200).percepts
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    percepts = world._percepts(seen)
    assert torch.allclose(percepts.mean(0), torch.zeros(6), atol=1e-4)
    assert torch.allclose(percepts.std(0), torch.ones(6), atol=1e-4)


def test_a_number_that_random_episodes_do_not_change_is_not_scaled() -> None:
    seen = np.stack([np.linspace(-1, 1, 9), np.full(9, 7.0)], 1)
    scaling = scaling_of(seen)
    assert scaling.centre.tolist() == pytest.approx([0, 7])
    assert scaling.scale.tolist() == pytest.approx([seen[:, 0].std(ddof=1), 1])


def test_it_is_kept_with_a_run(tmp_path: Path) -> None:
    domain = make_domain("gymnasium:Acrobot-v1")
    assert isinstance(domain, Gymnasium)
    domain.files(domain).write(tmp_path)
    again = Gymnasium.files.read(Gymnasium, domain.settings, tmp_path)
    assert again.target_return == -100.0
    assert torch.equal(again.known.scaling.scale, domain.known.scaling.scale)
    text = '{"centre": [1, 1], "scale": [1, 0], "target_return": 1}'
    (tmp_path / "gymnasium.json").write_text(text)
    with pytest.raises(DomainError, match="damaged"):
        Gymnasium.files.read(Gymnasium, domain.settings, tmp_path)
    (tmp_path / "gymnasium.json").write_text('{"centre": [1], "scale": [1], "target_return": 1}')
    with pytest.raises(DomainError, match="of another environment"):
        Gymnasium.files.read(Gymnasium, domain.settings, tmp_path)


def test_an_episode_that_is_over_goes_no_further() -> None:
    domain = domain_of("CartPole-v1")
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    lanes = started(world, 1)
    for _ in range(200):
        lanes, done = world.step(lanes, torch.tensor([[1.0, -1.0]]))
        if not done.any():
            break
    after, done = world.step(lanes, torch.tensor([[1.0, -1.0]]))
    assert not done.any()
    assert torch.equal(after.state, lanes.state)
    still = replace(lanes, state=lanes.state.clone())
    assert bool(world.success(still)[1] == 1.0)


def test_episodes_are_made_anew_in_another_process() -> None:
    domain = domain_of("Acrobot-v1")
    again = pickle.loads(pickle.dumps(domain.episodes))  # noqa: S301  our own bytes
    assert again.begin([5])[0] == pytest.approx(domain.episodes.begin([5])[0])


def test_a_forked_process_makes_environments_of_its_own() -> None:
    """One that is open may hold a window or a connection, which only its process may use."""
    domain = domain_of("Acrobot-v1")
    ours = domain.episodes.begin([3])[0]
    kept = [id(each) for each in domain.episodes._having.values()]

    def work(_: int) -> tuple[bool, int]:
        same = bool((domain.episodes.begin([3])[0] == ours).all())
        return same, sum(id(each) in kept for each in domain.episodes._having.values())

    assert in_processes(work, 2, 2) == [(True, 0), (True, 0)]
    assert work(0) == (True, 1)
