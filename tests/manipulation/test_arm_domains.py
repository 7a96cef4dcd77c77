"""Robot benchmarks as domains: names, stages, percepts, graded success, and a whole training."""

import pickle
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from arms import chain, fetch, meta_world, starts
from torch import Tensor

from cgtorch.domains.registry import is_code, make_domain, settings_class
from cgtorch.evolution import EvolutionSettings, evolve
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import DomainError
from cgtorch.improvement.events import Event, GenerationDone
from cgtorch.manipulation.metaworld import CW10
from cgtorch.manipulation.primitives import Primitive
from cgtorch.manipulation.settings import FetchSettings, ManipulationSettings
from cgtorch.manipulation.simulator import CLOSEST, SEEN, SOLVED, STEPS
from cgtorch.runs.log import read_log
from cgtorch.simulation import rollout
from cgtorch.training.run import open_run, train


def test_domains_have_names() -> None:
    assert not is_code("metaworld:CW10")
    assert not is_code("gymnasium-robotics:FetchPush-v4")
    assert settings_class("metaworld:push-v3") is ManipulationSettings
    assert settings_class("gymnasium-robotics:FetchPush-v4") is FetchSettings
    assert make_domain("metaworld:push-v3").kinds == ("push-v3",)
    assert make_domain("gymnasium-robotics:FetchReach-v4").kinds == ("FetchReach-v4",)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("metaworld:push-v9", "no task or set 'push-v9'"),
        ("metaworld", "names no environment; give metaworld:NAME, such as metaworld:push-v3"),
        ("gymnasium-robotics:FetchFly-v4", "no task 'FetchFly-v4'; give one of FetchReach-v4"),
    ],
)
def test_unknown_tasks_are_refused(name: str, said: str) -> None:
    with pytest.raises(DomainError, match=said):
        make_domain(name)


def test_sets_are_stages_in_their_order() -> None:
    twice = meta_world("CW20")
    assert twice.tasks == CW10
    assert list(twice.stages.values()) == [*CW10, *CW10]
    assert list(twice.stages)[::10] == ["01-hammer-v3", "11-hammer-v3"]
    drawn = twice.draw("every-task", 200, torch.Generator().manual_seed(0))
    assert twice.kinds == ("every-task", *CW10)
    assert drawn.task.bincount(minlength=10).min() > 5
    assert set(twice.draw("push-v3", 9, torch.Generator()).task.tolist()) == {6}
    assert meta_world("reach-v3").kinds == ("reach-v3",)
    assert len(meta_world("MT50").stages) == 50
    assert len(meta_world("MT10").stages) == 10


def test_percepts_tell_the_task_if_they_are_to() -> None:
    one, given, hidden = meta_world(), meta_world("CW10"), meta_world("CW10", task_id="hidden")
    assert len(given.percept) == len(one.percept) + 10
    assert [field.name for field in given.percept[-10:]] == list(CW10)
    assert len(hidden.percept) == len(one.percept)
    world = given.world(starts(given, 3, task=6))
    percept = world.start(torch.tensor([0]))[1]
    assert percept[0, -10:].tolist() == [0, 0, 0, 0, 0, 0, 1, 0, 0, 0]
    alone = one.world(starts(one, 3)).start(torch.tensor([0]))[1]
    assert torch.equal(percept[:, :-10], alone)


def test_states_of_a_set_have_room_for_all_its_tasks() -> None:
    """And a start of any of them is that of its simulator."""
    domain = meta_world("CW10")
    sizes = {domain.simulators[task].size for task in range(10)}
    assert len(sizes) > 1
    for task in range(10):
        world = domain.world(starts(domain, 3, task=task))
        state = world.start(torch.tensor([0]))[0]
        row = domain.simulators[task].start(3)
        assert state.shape == (1, max(sizes))
        assert state[0, : len(row)].tolist() == row.tolist()


def test_percepts_are_around_one() -> None:
    for domain in (meta_world(), fetch()):
        world = domain.world(starts(domain, *range(4)))
        percept = world.start(torch.arange(4))[1]
        assert percept.shape == (4, len(domain.percept))
        assert percept.abs().max() < 4


def test_success_is_graded_below_one_half() -> None:
    domain = meta_world("reach-v3")
    world = domain.world(starts(domain, 5, 6))
    actions = domain.actions()
    there = rollout(chain(domain, ("ReachGoal", (0.0,) * 3)), actions, world)
    near = rollout(chain(domain, ("ReachGoal", (5.0, 0.0, 0.0))), actions, world, max_transitions=1)
    first = world.start(torch.arange(2))[0]
    begun = start_lanes(world, torch.arange(2), 0, 0)
    for state in (first, near.state[0]):
        assert not state[:, SOLVED].any()
    values = []
    for state in (first, near.state[0], there.state[0]):
        lanes = replace(begun, state=state)
        values.append(world.success(lanes)[1])
        assert torch.equal(world.success(lanes)[1] > 0.5, state[:, SOLVED] > 0)
    assert (values[0] < values[1]).all()
    assert (values[1] < 0.46).all()
    assert (values[2] == 1).all()
    assert torch.equal(near.state[0][:, CLOSEST] > 0.1, torch.ones(2, dtype=torch.bool))


def test_a_search_gives_up_what_comes_no_closer() -> None:
    """And what succeeds in spite of that does so in the world, too."""
    domain = meta_world("reach-v3")
    world = domain.world(starts(domain, 5, 6))
    hurried, actions = world.hurried(), domain.actions()
    away = chain(domain, ("Shift", (-0.3, 0.0, 0.0)), ("Close", ()))
    there = chain(domain, ("Close", ()), ("ReachGoal", (0.0,) * 3))
    for graph, long, short in ((away, [200, 200], 150), (there, None, None)):
        whole, few = (rollout(graph, actions, each).state[0] for each in (world, hurried))
        if long:
            assert whole[:, STEPS].tolist() == long
            assert (few[:, STEPS] == 200).all()  # as if the time was over
            before = domain.simulators.asked.steps
            rollout(graph, actions, hurried)
            assert domain.simulators.asked.steps - before <= 2 * short
        else:
            assert whole[:, SOLVED].all()
            assert torch.equal(whole, few)
    assert torch.equal(rollout(away, actions, world).state[0, :, STEPS], torch.full((2,), 200.0))


def test_a_domain_can_be_pickled_for_another_process() -> None:
    domain = meta_world("reach-v3")
    sent = pickle.dumps(domain.world(starts(domain, 5)))
    world = pickle.loads(sent)  # noqa: S301  of our own
    mine = domain.world(starts(domain, 5)).start(torch.tensor([0]))[1]
    assert torch.equal(world.start(torch.tensor([0]))[1], mine)


@pytest.mark.hostile
def test_a_skill_is_trained_counted_and_tried(tmp_path: Path) -> None:
    """One after the other; what the first has learned is kept, and steps are counted by phase."""
    few = {"population": 12, "practice": 6}
    run = train("metaworld:MT10", tmp_path / "run", stage="01-reach-v3", seed=1, **few)
    assert run.stages == ("01-reach-v3",)
    rows = [row for row in read_log(run.folder) if row["event"] == "asked"]
    phases = {row["phase"] for row in rows}
    assert {"search", "practice"} <= phases
    assert all(row["simulated"] <= row["steps"] for row in rows)
    total = sum(row["steps"] for row in rows)
    assert 0 < total < 60_000
    assert sum(a["steps"] for a in run.results[-1]["asked"].values()) == total
    again = open_run(run.folder)
    again.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "of them simulated" in page
    assert f">{total}<" in page
    assert ("data:image/webp" in page) != ("There is no film of 01-reach-v3" in page)
    assert again.evaluate(scenarios="reach-v3", count=10).successes >= 8
    row = rollout(
        run.skill.graph, run.skill.actions, run.domain.world(starts(run.domain, 3)),
        max_transitions=run.skill.max_transitions,
    ).state[0, 0]  # fmt: skip
    assert row[SEEN:].isfinite().all()


@pytest.mark.hostile
def test_a_training_that_was_stopped_ends_as_if_it_had_not_been(tmp_path: Path) -> None:
    """What it knew of individuals that come again is asked again, of one generation."""
    about = {"stage": "01-reach-v3", "seed": 5, "population": 12, "practice": 3, "quiet": True}
    whole = train("metaworld:reach-v3", tmp_path / "whole", **about)
    told = list[str]()

    def watch(event: Event) -> bool:
        told.append(type(event).__name__)
        return isinstance(event, GenerationDone) and event.generation.number == 1

    train("metaworld:reach-v3", tmp_path / "stopped", watch=watch, checkpoint_seconds=0, **about)
    stopped = open_run(tmp_path / "stopped")
    if "StageFinished" not in told:
        stopped = stopped.resume(quiet=True)
    assert stopped.stages == whole.stages
    one, other = (
        (run.folder / "01-reach-v3" / "skill.json").read_text() for run in (whole, stopped)
    )
    assert one == other
    counts = [
        sum(phase["steps"] for phase in run.results[-1]["asked"].values())
        for run in (whole, stopped)
    ]
    assert counts[0] <= counts[1] <= counts[0] + 12 * whole.domain.settings.horizon


def test_parts_are_tried_once_where_low_level_steps_are_counted() -> None:
    """And actions of the library not at all."""
    domain, wave = meta_world("reach-v3"), Wave()
    world = domain.world(starts(domain, 5))
    steps = []
    for actions in (domain.actions(), domain.actions().extended(["Wave"], [wave])):
        settings = EvolutionSettings(population=2, elite=0, initial_nodes=(1, 1))
        for _ in range(2):
            before, wave.asked = world.asked.steps, 0
            search = evolve(world, actions, settings, torch.Generator().manual_seed(0))
            next(search)
            steps.append((world.asked.steps - before, wave.asked > 2))
    (first, own), (second, _), (_, tried), (_, again) = steps
    assert first > second
    assert (own, tried, again) == (False, True, False)


class Wave(Primitive):
    """An action of one's own, which notes how many lanes it was tried on."""

    num_parameters = 0
    asked = 0

    def __init__(self) -> None:
        super().__init__(meta_world("reach-v3").arm)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        self.asked += len(lanes)
        return lanes, lanes.step.new_zeros(len(lanes))
