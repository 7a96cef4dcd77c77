"""Searches over primitives: what is dropped early, what is counted, and the environment."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import compare_robot_tasks as tool
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from robot_tasks import ours, ppo, random_search, scripted_cma
from robot_tasks.environment import WIDEST, Primitives
from robot_tasks.problem import Problem, first_failure, grade
from robot_tasks.random_search import first_good
from robot_tasks.scripts import SCRIPTS, script_of
from robot_tasks.table import table

from cgtorch.graphs import Graphs, valid
from cgtorch.ground.errors import SettingsError
from cgtorch.manipulation.simulator import SOLVED, STEPS
from cgtorch.manipulation.world import ArmWorld
from cgtorch.simulation import rollout

REACH = "metaworld:reach-v3"


@dataclass
class Counted:
    """Candidates that are rows of what they solve, of which every look costs one."""

    table: list[list[bool]]
    budget: int
    asked: int = 0
    looked: list[tuple[int, int]] = field(default_factory=list)

    def in_a_row(self, candidate: int) -> int:
        def solves(start: int) -> bool:
            if self.over():
                return False
            self.asked += 1
            self.looked.append((candidate, start))
            return self.table[candidate][start]

        return first_failure(solves, len(self.table[0]))

    def over(self) -> bool:
        return self.asked >= self.budget


def plain(solved: list[list[bool]], budget: int) -> tuple[int | None, int, int]:
    """The same by loops over everything: the best candidate, its number, and what it cost."""
    best, most, asked = None, -1, 0
    for candidate, row in enumerate(solved):
        if asked >= budget:
            break
        number = 0
        for one in row:
            if asked >= budget:
                break
            asked += 1
            if not one:
                break
            number += 1
        if number > most:
            best, most = candidate, number
        if most == len(row):
            break
    return best, most, asked


@st.composite
def tables(draw: Any) -> list[list[bool]]:
    width = draw(st.integers(1, 6))
    row = st.lists(st.sampled_from([True, True, True, False]), min_size=width, max_size=width)
    return draw(st.lists(row, max_size=8, min_size=1))


@given(tables(), st.integers(0, 60))
def test_a_race_finds_what_a_plain_loop_finds(solved: list[list[bool]], budget: int) -> None:
    counted = Counted(solved, budget)
    found = first_good(range(len(solved)), counted.in_a_row, len(solved[0]), counted.over)
    assert (*found, counted.asked) == plain(solved, budget)
    assert len(set(counted.looked)) == len(counted.looked)
    if found[0] is not None and found[1] == len(solved[0]):
        assert all(solved[found[0]])
        assert not any(map(all, solved[: found[0]]))


def test_random_graphs_are_valid_and_repeat_themselves() -> None:
    one, other = (random_search.graphs(Problem(REACH, 3)) for _ in range(2))
    actions = Problem(REACH, 3).domain.actions()
    for first, again in zip(one, (next(other) for _ in range(5)), strict=False):
        assert bool(valid(first, actions).all())
        assert first.num_nodes.item() <= 8
        assert torch.equal(first.parameters, again.parameters)


def test_a_failure_costs_no_more_than_its_episode() -> None:
    problem = Problem(REACH, 0)
    away = one_node(problem, "ReachGoal", (9.0, 0.0, 0.0))
    assert problem.in_a_row(problem.player(away)) == 0
    assert 0 < problem.asked.steps <= problem.domain.settings.horizon


def test_what_solves_the_group_practises_on_fresh_starts() -> None:
    problem, seen = Problem(REACH, 0, practice=4), set[int]()
    plays = problem.player(one_node(problem, "ReachGoal", ()))

    def play(world: ArmWorld) -> torch.Tensor:
        seen.update(world.scenarios.seed.tolist())
        return plays(world)

    assert problem.in_a_row(play) == problem.wanted == 36
    assert set(problem.group.seed.tolist()) < seen
    assert len(seen) == 36


def test_nothing_is_asked_beyond_the_budget() -> None:
    problem = Problem(REACH, 0, budget=500)
    found = random_search.search(problem)
    assert not found.met
    assert 500 <= found.asked.steps <= 700
    assert problem.in_a_row(problem.player(one_node(problem, "ReachGoal", ()))) == 0


def test_a_grade_is_that_of_the_world() -> None:
    problem = Problem(REACH, 0)
    world = problem.domain.world(problem.group[:3])
    graph = one_node(problem, "ReachGoal", (2.0, 1.0, 0.0))
    state = rollout(graph, problem.domain.actions(), world, max_transitions=1).state[0]
    state[0, SOLVED] = 1
    environment = Primitives(problem.domain)
    environment.begin(problem.domain.world(problem.group[:1]))
    for i in range(3):
        lanes = environment.lanes.moved(state[i : i + 1], environment.lanes.percept)
        assert float(grade(state[i])) == pytest.approx(float(world.success(lanes)[1]))


def test_scripts_are_graphs_in_a_circle() -> None:
    problem = Problem("metaworld:stick-pull-v3", 0)
    actions, steps = problem.domain.actions(), script_of(problem.task)
    size = len(scripted_cma.deviations(actions, steps))
    parameters = torch.randn(5, size)
    graphs = scripted_cma.chains(actions, steps, parameters)
    assert bool(valid(graphs, actions).all())
    assert [actions.names[i] for i in graphs.action[0].tolist()] == list(steps)
    assert graphs.edges[0, :, 0].tolist() == [1, 2, 0]
    assert torch.equal(torch.cat([*graphs.parameters[2, :, :3]]), parameters[2])


def test_every_script_has_primitives_that_there_are() -> None:
    arm = Problem(REACH, 0).domain
    for task in SCRIPTS:
        own = task.startswith("Fetch")  # its tasks have different ones
        domain = Problem(f"gymnasium-robotics:{task}", 0).domain if own else arm
        assert set(script_of(task)) <= set(domain.primitives())
    with pytest.raises(SettingsError, match="'walk-v3' has no script for cma"):
        script_of("walk-v3")


def test_several_tasks_are_refused() -> None:
    with pytest.raises(ValueError, match="no single task"):
        Problem("metaworld:MT10", 0)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_environment_is_one_of_gymnasium() -> None:
    checker = pytest.importorskip("gymnasium.utils.env_checker")
    checker.check_env(Primitives(Problem("metaworld:push-v3", 0).domain), skip_render_check=True)


def test_rewards_sum_up_to_the_grade_and_one_for_success() -> None:
    environment = Primitives(Problem(REACH, 0).domain)
    action = np.full(environment.action_space.shape, -WIDEST, dtype=np.float32)
    size = len(environment.actions)
    action[size:] = 0
    action[environment.actions.index("Close")] = 1
    observation, _ = environment.reset(seed=1)
    assert environment.observation_space.contains(observation)
    before = float(grade(environment.lanes.state))
    rewards = [environment.step(action)[1]]
    action[environment.actions.index("ReachGoal")] = 2
    observation, reward, over, cut, info = environment.step(action)
    assert (over, cut, info["is_success"]) == (True, False, True)
    assert sum([*rewards, reward]) == pytest.approx(2 - before)


def test_an_episode_ends_with_its_last_step() -> None:
    environment = Primitives(Problem(REACH, 0).domain)
    environment.reset(seed=1)
    action = np.full(environment.action_space.shape, -WIDEST, dtype=np.float32)
    action[environment.actions.index("Close")] = 1
    ends = [environment.step(action)[2] for _ in range(17)]  # of 12 low-level steps each
    assert ends == 16 * [False] + [True]
    assert environment.lanes.state[0, STEPS] == environment.domain.settings.horizon


def test_ppo_learns_up_to_the_budget() -> None:
    pytest.importorskip("stable_baselines3")
    problem = Problem(REACH, 0, budget=2500)
    found = ppo.search(problem, decisions=32)
    assert found.met or 2500 <= found.asked.steps < 2900
    assert found.play is not None
    assert found.play(problem.domain.world(problem.group[:1]))[STEPS] > 0


@pytest.mark.hostile
def test_ours_ends_by_its_criterion_or_by_the_budget() -> None:
    few = {"population": 12}
    found = ours.search(Problem(REACH, 1, practice=6), **few)
    assert found.met
    assert found.play is not None
    problem = Problem("metaworld:push-v3", 1, budget=300, practice=6)
    short = ours.search(problem, **few)
    assert not short.met
    assert short.play is not None
    assert short.asked.steps >= 300


@pytest.mark.hostile
def test_results_are_kept_and_make_a_table(tmp_path: Path) -> None:
    given = [str(tmp_path), REACH, "--seeds", "0:2", "--searches", "cma", "--count", "2"]
    outputs = [CliRunner().invoke(tool.command, given).stdout for _ in range(2)]
    assert outputs[0] == outputs[1] == (tmp_path / "table.md").read_text() + "\n"
    assert "| reach-v3 | cma | 2 | 2 of 2 |" in outputs[0]
    assert len(list(tmp_path.glob("*.json"))) == 2


def test_a_median_that_is_not_reached_is_more_than_the_budget() -> None:
    row = {"task": "a", "search": "ours", "official": [1, 2, 9.0], "seconds": 1.0}
    rows = [
        row | {"met": met, "requested": steps, "simulated": steps // 2}
        for met, steps in ((True, 10), (False, 100), (False, 100))
    ]
    assert "| a | ours | 3 | 1 of 3 | > 100 | > 50 | 50% | 1 |" in table(rows, {"ours": "nothing"})
    assert "| a | ours | 1 | 1 of 1 | 10 | 5 |" in table(rows[:1], {"ours": "nothing"})


def one_node(problem: Problem, name: str, values: tuple[float, ...]) -> Graphs:
    """A graph that repeats one primitive."""
    actions = problem.domain.actions()
    parameters = torch.zeros(1, int(actions.num_parameters[actions.index(name)]))
    parameters[0, : len(values)] = torch.tensor(values)
    return scripted_cma.chains(actions, (name,), parameters)
