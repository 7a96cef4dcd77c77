"""The example's world is Gymnasium's, its Γ is right, and its skill does what is said of it."""

import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from support import same, seeded

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from cgtorch.actions import check_action
from cgtorch.environment.dry_run import check_environment
from cgtorch.environment import start_lanes
from cgtorch.evolution import evolve
from cgtorch.graphs import Graphs, Skill, load_skill
from cgtorch.improvement.events import Event, SkillAccepted, WorldTested
from cgtorch.simulation import Recording, rollout
from examples.mountain_car import __main__ as command
from examples.mountain_car.actions import car_actions
from examples.mountain_car.models import MOST_NEW, CarModels, imagine, learn, load_models
from examples.mountain_car.train import STAGES, car_setup, drive, points, train, tried
from examples.mountain_car.world import (
    ANYWHERE,
    ID,
    MOST_STEPS,
    PUSH,
    SOLVED,
    VALLEY,
    MountainCar,
    draw_starts,
)

ACTIONS = car_actions()


@pytest.fixture(scope="module")
def models() -> CarModels:
    return load_models(command.TRAINED)


@pytest.fixture(scope="module")
def skill() -> Skill:
    return load_skill(command.TRAINED / "skill.json", ACTIONS)


def played(seed: int, between: tuple[float, float], forces: list[float]) -> tuple[bool, float]:
    """An episode of plain Gymnasium: whether the flag was reached, and the points."""
    environment = gymnasium.make(ID)
    environment.reset(seed=seed, options={"low": between[0], "high": between[1]})
    total, over = 0.0, False
    for force in forces:
        for _ in range(PUSH):
            _, reward, over, stopped, _ = environment.step(np.array([force], dtype=np.float32))
            total += float(reward)
            if over or stopped:
                return over, total
    return over, total


@pytest.mark.parametrize("between", [VALLEY, ANYWHERE])
def test_the_world_is_gymnasium(skill: Skill, between: tuple[float, float]) -> None:
    """All episodes side by side end as each does alone, in an environment of its own."""
    starts = draw_starts(20, seeded(7), between)
    limit = skill.max_transitions
    runs = rollout(skill.graph, ACTIONS, MountainCar(starts), max_transitions=limit)
    for i in range(20):
        alone = Recording(MountainCar(starts[i : i + 1]))
        one = rollout(skill.graph, ACTIONS, alone, max_transitions=limit)
        assert torch.equal(one.state[0, 0], runs.state[0, i])
        forces = torch.cat([u for _, u, _ in alone.transitions])[:, 0].tolist()
        over, total = played(int(starts.seed[i]), between, forces)
        assert over == bool(runs.state[0, i, 4])
        assert total == pytest.approx(float(runs.state[0, i, 3]), abs=1e-9)
        assert bool(runs.succeeded[0, i]) == (over and total >= SOLVED)


def test_an_episode_has_an_end() -> None:
    """Without a force the car stays in the valley until Gymnasium stops it."""
    world = MountainCar(draw_starts(2, seeded(0)))
    lanes = start_lanes(world, torch.arange(2), 0, 0)
    idle = torch.zeros(2, 1)
    for _ in range(-(-MOST_STEPS // PUSH)):
        lanes, moved = world.step(lanes, idle)
        assert moved.all()
    assert (lanes.state[:, 2] == MOST_STEPS).all()
    after, moved = world.step(lanes, idle)
    assert not moved.any()
    assert torch.equal(after.percept, lanes.percept)
    assert not world.success(after)[1].any()
    assert (lanes.percept[:, 2] == 0).all()
    _, moved = world.step(start_lanes(world, torch.arange(2), 0, 0), idle + float("nan"))
    assert not moved.any()


def test_world_and_actions_keep_the_interfaces(models: CarModels) -> None:
    world = MountainCar(draw_starts(3, seeded(0)))
    check_environment(world)
    imagined = imagine(models, world.start(torch.arange(3))[1], 2, seeded(1))
    check_environment(imagined)
    for place in (world, imagined):
        for name, action in zip(ACTIONS.names, ACTIONS.actions, strict=True):
            check_action(name, action, place)
    nobody = MountainCar(draw_starts(0, seeded(0)))
    assert nobody.start(torch.arange(0))[1].shape == (0, 3)


def test_gamma_and_c_are_right_on_fresh_drives(models: CarModels) -> None:
    """Γ errs by a hundredth of the way; C knows the flag, and whether too much was spent."""
    fresh = drive(seeded(123))
    predicted, novelty = models.predict(fresh.percept, fresh.motion)
    error = (predicted - fresh.next_percept).abs().mean(0)
    still = (fresh.percept - fresh.next_percept).abs().mean(0)
    assert error[0] < 0.01
    assert error[1] < 0.015
    assert error[2] < 0.0002
    assert (error < still / 15).all()
    assert (novelty < 0.75).float().mean() > 0.95
    away = fresh.percept + torch.tensor([3.0, 0.0, 0.0])
    assert (models.predict(away, fresh.motion)[1] > 0.75).all()
    believed = models.success(fresh.grasp_percept) > 0.5
    truth = fresh.graspable
    assert 10 < truth.sum() < len(truth) / 2
    assert (believed == truth).float().mean() > 0.98
    assert believed[truth].float().mean() > 0.9


@pytest.mark.parametrize("stage", list(STAGES))
def test_the_stored_skill_solves_fresh_starts(skill: Skill, stage: str) -> None:
    """At least 99 % of 1,000 starts end at the flag with the 90 points that count as solved."""
    starts = draw_starts(1000, seeded(31), STAGES[stage])
    succeeded, earned = tried(skill, starts)
    assert succeeded.float().mean() >= command.GOAL
    assert earned.mean() >= SOLVED


def test_the_fitness_is_what_an_episode_earns(skill: Skill, models: CarModels) -> None:
    starts = draw_starts(10, seeded(3))
    world = MountainCar(starts)
    limit = skill.max_transitions
    runs = rollout(skill.graph, ACTIONS, world, max_transitions=limit)
    worth = points(runs, torch.ones(1, 10))
    assert torch.allclose(100 * worth[0], runs.state[0, :, 3].float(), atol=1e-3)
    none = replace(runs, succeeded=torch.zeros_like(runs.succeeded))
    assert (points(none, torch.full((1, 10), 0.4)) == 0.2).all()
    # The models foretell it.
    imagined = imagine(models, world.start(torch.arange(10))[1], 1, seeded(0))
    guessed = rollout(skill.graph, ACTIONS, imagined, max_transitions=limit)
    both = guessed.succeeded & runs.succeeded
    assert both.float().mean() > 0.7
    foretold = points(guessed, torch.ones(1, 10))
    assert (foretold - worth)[both].abs().mean() < 0.02


def test_one_seed_gives_one_result(models: CarModels) -> None:
    def made(seed: int) -> tuple[CarModels, Graphs]:
        generator, setup = seeded(seed), car_setup()
        more = learn(models, drive(generator), generator)
        percepts = MountainCar(draw_starts(4, generator)).start(torch.arange(4))[1]
        search = evolve(
            imagine(more, percepts, 2, generator),
            ACTIONS,
            replace(setup.evolution, population=20),
            generator,
        )
        for _ in range(3):
            population = next(search).population.graphs
        return more, population

    (one, first), (two, second) = made(5), made(5)
    assert len(one.data.percept) == len(models.data.percept) + MOST_NEW
    assert torch.equal(one.gamma.weights, two.gamma.weights)
    assert torch.equal(one.classifier.weights, two.classifier.weights)
    assert same(first, second)


def test_a_skill_is_trained(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The command, with all stages of Algorithm 1: nothing is lost, and what is tried is kept."""
    events: list[Event] = []
    whole = train

    def listened(seed: int, watch: object, working: object) -> object:
        del watch, working
        return whole(seed, events.append, lambda message: nullcontext())

    monkeypatch.setattr(command, "train", listened)
    ended = CliRunner().invoke(
        command.group, ["train", str(tmp_path / "car"), "--seed", "3", "--count", "100"]
    )
    assert ended.exit_code == 0, ended.output
    accepted = [e for e in events if isinstance(e, SkillAccepted)]
    assert accepted[0].stage == "valley"
    assert accepted[-1].stage == "anywhere"
    for event in accepted:
        assert event.succeeded[event.keep].all()
        assert event.succeeded[~event.keep].any()
        assert torch.equal(tried(event.skill, event.scenarios)[0], event.succeeded)
    assert any(isinstance(e, WorldTested) for e in events)
    assert "of 100 fresh starts solved" in ended.output
    again = CliRunner().invoke(command.group, ["test", str(tmp_path / "car"), "--count", "100"])
    assert again.exit_code == 0
    assert again.output == ended.output


def test_it_shares_nothing_with_the_tabletop() -> None:
    folder = command.TRAINED.parent
    imported = {
        line.split()[1]
        for file in folder.glob("*.py")
        for line in file.read_text().splitlines()
        if line.startswith(("from cgtorch", "import cgtorch"))
    }
    assert len(imported) > 10
    tabletop = ("cgtorch.tabletop.world", "cgtorch.tabletop.kinematics", "cgtorch.domains.knowledge")
    assert not [name for name in imported if name.startswith(tabletop)]
