"""Peers in locomotion: their updates by hand, their statistics by numpy, and a task they solve."""

import json
from dataclasses import replace
from pathlib import Path

import compare_locomotion as tool
import numpy as np
import pytest
from click.testing import CliRunner
from compare_locomotion import Row, table
from locomotion import ars
from locomotion.episodes import Linear, Seen, Trial

POLE = "InvertedPendulum-v5"  # which is kept up for 1,000 steps at most


def test_statistics_of_parts_are_those_of_the_whole() -> None:
    rows = np.random.default_rng(0).normal([1e3, -2, 5], [1e-3, 4, 0], (50, 3))
    seen, other = Seen.nothing(3), Seen.nothing(3)
    for part in (rows[:1], rows[1:20]):
        seen.add(part)
    for part in (rows[20:21], rows[21:]):
        other.add(part)
    seen.join(other)
    assert seen.count == 50
    assert seen.mean == pytest.approx(rows.mean(0))
    assert seen.deviation[:2] == pytest.approx(rows[:, :2].std(0, ddof=1))
    assert seen.deviation[2] == np.inf
    assert Seen.nothing(2).deviation.tolist() == [1, 1]


def test_a_policy_sees_normalised_observations() -> None:
    policy = Linear(
        np.array([[2.0, 1.0]]), np.array([0.5]), np.array([3.0, 9]), np.array([4, np.inf])
    )
    weights, bias = policy.plain()
    assert weights @ [7.0, 1e6] + bias == pytest.approx([2 * (7 - 3) / 4 + 0.5])


def test_an_update_follows_the_best_directions_in_units_of_their_spread() -> None:
    settings = ars.Settings(3, 2, 0.5, 0.1)
    directions = np.array([[[1.0, 0]], [[0, 1]], [[5, 5]]])
    returns = np.array([[3.0, 1], [0, 4], [2, 2]])  # the last direction has the lowest maximum
    spread = np.std([3, 1, 0, 4])
    wanted = 0.5 / (2 * spread) * np.array([[3 - 1, 0 - 4]])
    assert ars.update(directions, returns, settings) == pytest.approx(wanted)
    assert not ars.update(directions, np.ones((3, 2)), settings).any()


class Target:
    """In place of a trial: what a policy is worth is its distance from given weights."""

    name, outputs, inputs, wanted = "none", 1, 2, np.array([[0.2, -0.1]])

    def __init__(self) -> None:
        self.generator, self.open, self.played = np.random.default_rng(0), True, 0

    def play(self, policy: Linear, toll: float, seen: Seen) -> float:
        self.played += 1
        seen.add(self.generator.normal(5, 3, (10, 2)))
        return -float(np.abs(policy.weights - self.wanted).sum())

    def look(self, policy: Linear) -> None:
        self.open = self.played < 600


def test_random_search_comes_near_the_best_policy() -> None:
    found = ars.search(Target())  # type: ignore[arg-type]
    assert found.weights == pytest.approx(Target.wanted, abs=0.03)
    assert found.mean == pytest.approx([5, 5], abs=0.3)
    assert found.deviation == pytest.approx([3, 3], abs=0.3)


def test_a_search_ends_with_its_steps_and_looks_at_ten_policies_at_most() -> None:
    trial = Trial(POLE, 0, 2000)
    first = ars.search(trial)
    assert 2000 <= trial.steps < 2000 + 16 * 1000
    assert trial.episodes % 16 == 0
    assert 0 < len(trial.curve) <= 10
    assert trial.curve == sorted(trial.curve)
    assert np.array_equal(first.weights, ars.search(Trial(POLE, 0, 2000)).weights)


def test_a_toll_takes_off_what_survival_gives() -> None:
    trial, fallen = Trial(POLE, 0, 1), Linear(np.zeros((1, 4)))
    assert trial.play(fallen, toll=1.0) == -1.0  # the last step of an episode is worth nothing
    seen = Seen.nothing(4)
    gained = trial.play(fallen, seen=seen)
    assert seen.count == gained + 1


@pytest.mark.hostile
def test_the_command_compares_equal_steps_and_keeps_results(tmp_path: Path) -> None:
    folder = tmp_path / "new"
    about = ["--only", "InvertedDoublePendulum-v5", "--seeds", "0:1", "--steps", "3000"]
    about += ["--method", "ars", "--method", "ours"]
    outputs = [CliRunner().invoke(tool.command, [str(folder), *about]) for _ in range(2)]
    assert [each.exit_code for each in outputs] == [0, 0], outputs[0].output
    first, second = (each.output[each.output.index("| environment") :] for each in outputs)
    assert first == second
    kept = json.loads((folder / "InvertedDoublePendulum-v5-0" / "measured.json").read_text())
    assert kept["steps"] == 3000
    other = json.loads((folder / "InvertedDoublePendulum-v5-0-ars.json").read_text())
    assert 3000 <= other["steps"] < 4000


def test_the_table_has_medians_in_the_order_of_seeds() -> None:
    one = Row("Hopper-v5", "ars", 0, 5.0, 100, 1.0)
    rows = [one, replace(one, seed=1, mean_return=-1.0), replace(one, seed=2, mean_return=3.0)]
    last = table(rows).splitlines()[-1]
    assert last == "| Hopper-v5 | ars | 3.0 | 5.0, -1.0, 3.0 | 100 |"
