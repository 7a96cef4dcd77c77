"""The frame of the standard tasks; what it measures is never a test."""

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import standard_tasks
import torch
from click.testing import CliRunner, Result
from standard.measure import BUDGETS, Budget, Trial, alike, played, player
from standard.measure import Result as Found
from standard.peers import LIBRARIES, Library, UnsuitableError
from standard.task import Starts
from standard.tasks import TASKS
from torch import Tensor

CARTPOLE = TASKS["cartpole"]
FALLING = 10  # steps a cart always pushed to one side lasts at most, and 8 at least


@pytest.fixture(autouse=True)
def environment_as_before() -> Any:
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


def to_the_right(percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
    return torch.tensor([[0.0, 1.0]]).repeat(len(percept), 1), None


def balancing(percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
    leaning = percept @ torch.tensor([0.1, 0.3, 1.0, 1.0])
    return torch.stack([-leaning, leaning], 1), None


def counting(percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
    """The second half of lanes is pushed to the other side after two steps."""
    memory = torch.zeros(len(percept)) if memory is None else memory + 1
    turned = (torch.arange(len(percept)) >= len(percept) // 2) & (memory > 1)
    return torch.stack([turned.float(), 1 - turned.float()], 1), memory


def a_trial(task: str = "cartpole", **changes: Any) -> Trial:
    return Trial(TASKS[task], "test", 0, replace(Budget(1000, 1000), **changes))


def test_what_a_policy_does_is_counted() -> None:
    trial = a_trial()
    returns = trial.returns(to_the_right, individuals=3, count=4)
    assert returns.shape == (3, 4)
    assert ((returns >= FALLING - 2) & (returns <= FALLING)).all()
    assert torch.equal(returns, returns[:1].expand(3, 4))  # all of them meet the same starts
    counts = trial.counts
    # In CartPole every step of an episode counts 1.
    assert (counts.evaluations, counts.episodes) == (3, 12)
    assert counts.world_steps == int(returns.sum())
    own = trial.returns(to_the_right, individuals=50, count=1, common=False)
    assert own.shape == (50, 1)
    assert len(own.unique()) > 1
    assert (counts.evaluations, counts.episodes) == (53, 62)
    assert counts.world_steps == int(returns.sum() + own.sum())


def test_lanes_that_are_over_take_no_more_steps() -> None:
    trial = a_trial()
    world = trial.world(2)
    lanes_of = world.start(torch.arange(2))
    assert trial.counts.episodes == 2
    returns = played(world, counting, torch.tensor([0, 1, 0, 1]))
    assert returns[2:].min() > returns[:2].max()
    assert trial.counts.episodes == 6
    assert trial.counts.world_steps == int(returns.sum())
    assert len(lanes_of[0]) == 2


def test_a_control_that_is_no_number_does_not_stop_the_clock() -> None:
    def nothing(percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        return torch.full((len(percept), 2), torch.nan), None

    assert played(CARTPOLE.world(Starts(torch.arange(2))), nothing, torch.arange(2)).max() < 20


def test_trained_and_tested_starts_are_different() -> None:
    trial = a_trial()
    trained = trial.world(1000).scenarios.seed
    assert (trained % 2 == 0).all()
    assert len(trained.unique()) == 1000
    seen = []

    def watching(world: Any) -> Tensor:
        seen.append(world.scenarios.seed)
        return torch.zeros(1)

    trial.offer(watching, 475.0)
    assert len(seen[0]) == 100
    assert (seen[0] % 2 == 1).all()


def test_a_champion_is_tried_once_it_is_good_in_training() -> None:
    trial = a_trial()
    trial.offer(player(balancing), 474.9)
    assert (trial.solved, trial.mean_return, trial.open) == (False, None, True)
    trial.offer(player(to_the_right), 475.0, "one")
    assert not trial.solved
    assert (trial.mean_return or 0) < 475
    trial.offer(player(balancing), 475.0, "two")
    assert (trial.solved, trial.open) == (True, False)
    result = trial.result()
    assert (result.mean_return, result.evaluations, result.world_steps) == (500, 0, 0)
    assert result.cpu_seconds > 0


@pytest.mark.parametrize(("task", "times"), [("cartpole", 2), ("double_pole", 1)])
def test_the_same_champion_is_tried_again_if_episodes_differ(task: str, times: int) -> None:
    trial, worlds = Trial(TASKS[task], "none", 0, BUDGETS[task]), []

    def failing(world: Any) -> Tensor:
        worlds.append(world)
        return torch.zeros(1)

    for _ in range(2):
        trial.offer(failing, trial.task.solved, "the same")
    assert len(worlds) == times


def test_who_has_not_solved_it_is_tried_in_the_end() -> None:
    trial = a_trial()
    assert trial.result().mean_return is None
    trial.offer(player(to_the_right), 9.0)
    result = trial.result("a note")
    assert (result.note, result.solved) == ("a note", False)
    assert FALLING - 2 <= (result.mean_return or 0) <= FALLING


def test_a_search_ends_with_its_budget() -> None:
    assert not a_trial(cpu_seconds=0).open
    trial = a_trial(evaluations=5)
    for count, left in ((4, True), (1, False)):
        trial.evaluated(count)
        assert trial.open is left


def test_where_episodes_begin_alike_one_is_enough() -> None:
    known = {name for name, task in TASKS.items() if name != "lunar_lander" and alike(task)}
    assert known == {"double_pole", "double_pole_no_velocities"}
    assert a_trial("double_pole").starts(8) == 1
    assert a_trial().starts(8) == 8


def test_further_tests_have_to_be_passed() -> None:
    trial = a_trial("double_pole_no_velocities")
    tried: list[int] = []

    def good(world: Any, enough: int = 200) -> Tensor:
        tried.append(world.num_scenarios)
        returns = torch.zeros(world.num_scenarios)
        returns[:enough] = 100_000.0
        return returns

    trial.offer(lambda world: good(world, 199), 0.1)
    assert not trial.solved
    assert tried == [1, 625]
    trial.offer(good, 0.1)
    assert trial.solved
    assert tried == [1, 625, 1, 625, 1]


def run(*words: str) -> Result:
    return CliRunner().invoke(standard_tasks.command, words, catch_exceptions=False)


def found(task: str, library: str, seed: int) -> Found:
    return Found(task, library, seed, True, 10 * seed, 2, 3, 4.0, 0.5, 500.0)


@pytest.fixture
def one_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LIBRARIES, "evosax", Library("not_there_at_all", "not-there", "nowhere"))


def test_the_command(one_missing: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output = tmp_path / "results.json"
    words = ["--only", "cartpole", "--library", "cgtorch", "--library", "evosax"]
    words += ["--seeds", "0:1", "--output", str(output)]
    ran = run(*words, "--json")
    whole = json.loads(ran.stdout)
    assert whole.keys() == {"tasks", "machine", "versions"}
    assert whole["versions"]["cgtorch"]
    ours, other = whole["tasks"]["cartpole"]["cgtorch"], whole["tasks"]["cartpole"]["evosax"]
    assert ours.keys() == other.keys()
    assert (ours["solved"], ours["seeds"]) == (1, 1)
    for name in ("evaluations", "episodes", "world_steps", "cpu_seconds", "mean_return"):
        assert ours[f"{name}_median"] > 0
        assert ours[f"{name}_range"] == [ours[f"{name}_median"]] * 2
        assert other[f"{name}_median"] is None
    assert other["note"] == "not installed"
    assert "cartpole, cgtorch, seed 0: solved" in ran.stderr

    kept = json.loads(output.read_text())["results"]
    assert [Found(**each).evaluations for each in kept] == [ours["evaluations_median"]]
    monkeypatch.setattr(standard_tasks, "apart", None)  # nothing is made again
    assert json.loads(run(*words, "--json").stdout)["tasks"] == whole["tasks"]
    further = run(*words, "--seeds", "0:3", "--kept-only", "--json")
    assert json.loads(further.stdout)["tasks"] == whole["tasks"]
    lines = run(*words).stdout.splitlines()
    assert len(lines) == 4
    assert lines[2].startswith("| CartPole | cgtorch | 1 of 1 | ")
    assert lines[3] == "| CartPole | evosax | – | – | – | – | – | not installed |"


def test_a_search_can_be_given_less() -> None:
    less = standard_tasks.apart("repeat_first", "cgtorch", 1, Budget(60, 49))
    assert not less.solved
    assert 49 <= less.evaluations < 200


def test_seconds_take_the_place_of_those_of_the_task(monkeypatch: pytest.MonkeyPatch) -> None:
    given = []

    def apart(task: str, library: str, seed: int, budget: Budget) -> Found:
        given.append(budget)
        return found(task, library, seed)

    monkeypatch.setattr(standard_tasks, "apart", apart)
    words = ["--only", "cartpole", "--library", "cgtorch", "--seeds", "3:4"]
    run(*words, "--cpu-seconds", "7", "--evaluations", "5")
    run(*words)
    assert given == [Budget(7, 5), BUDGETS["cartpole"]]
    assert BUDGETS.keys() == TASKS.keys()


def test_rows_of_a_figure_are_replaced_and_others_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = tmp_path / "figure.json"
    columns = ["task", "library", "solved", "world steps"]
    peer = ["CartPole", "evosax", "9 of 9", "7"]
    old = [["CartPole", "cgtorch", "0 of 1", "–"], peer]
    figure.write_text(json.dumps({"title": "Tasks", "columns": columns, "rows": old}))
    monkeypatch.setattr(standard_tasks, "apart", lambda *words: found(*words[:3]))
    words = ["--only", "cartpole", "--library", "cgtorch", "--library", "one lineage"]
    assert run(*words, "--seeds", "3:4", "--figure", str(figure)).exit_code == 0
    written = json.loads(figure.read_text())
    assert written["title"] == "Tasks"
    new = [["CartPole", name, "1 of 1", "3"] for name in ("cgtorch", "one lineage")]
    assert written["rows"] == [new[0], peer, new[1]]


def test_what_has_failed_is_said_and_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--only", "cartpole", "--library", "cgtorch", "--seeds", "3:5"]
    words += ["--output", str(tmp_path / "results.json")]
    made = []

    def apart(task: str, library: str, seed: int, budget: Budget) -> Found:
        made.append(seed)
        if made == [3]:
            return standard_tasks._failed(task, library, seed, "it broke")
        return found(task, library, seed)

    monkeypatch.setattr(standard_tasks, "apart", apart)
    costs = "| 2 | 3 | 4.0, 0.5 of them compiling |"
    row = run(*words).stdout.splitlines()[2]
    assert row == f"| CartPole | cgtorch | 1 of 1 | 40 {costs} failed: it broke |"
    row = run(*words).stdout.splitlines()[2]
    assert row == f"| CartPole | cgtorch | 2 of 2 | 35 (30–40) {costs}  |"
    assert made == [3, 4, 3]


def test_a_process_that_dies_ends_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standard_tasks, "_search", os._exit)  # which takes no such arguments
    dead = standard_tasks.apart("cartpole", "cgtorch", 0, Budget(60, 100))
    assert (dead.note, dead.solved) == ("failed: exit code 1", False)


class Answers(list[Found]):
    """What takes the place of the pipe to the process that waits."""

    send = list.append


@pytest.mark.parametrize(
    ("error", "note"),
    [
        (UnsuitableError("it cannot"), "it cannot"),
        (ValueError("two\nlines"), "failed: ValueError: two lines"),
    ],
)
def test_an_error_becomes_a_note(
    error: Exception, note: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def search(trial: Trial) -> None:
        trial.evaluated(7)
        raise error

    monkeypatch.setattr("standard.ours.search", search)
    answers: Any = Answers()
    standard_tasks._search(answers, "cartpole", "cgtorch", 0, BUDGETS["cartpole"])
    assert [(each.note, each.solved, each.evaluations) for each in answers] == [(note, False, 7)]
    assert asdict(answers[0])["seed"] == 0


def test_a_library_that_cannot_be_imported_is_said_so(one_missing: None) -> None:
    answers: Any = Answers()
    standard_tasks._search(answers, "cartpole", "evosax", 0, BUDGETS["cartpole"])
    assert answers[0].note.startswith("failed: cannot be imported (")
