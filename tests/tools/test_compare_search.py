"""The logic of the comparison; what it measures is never a test."""

from pathlib import Path

import click.testing
import compare_search
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import rankdata, wilcoxon
from searches.problems import Problem
from searches.statistics import midranks, signed_rank
from searches.table import on_the_way, table
from searches.trial import tried
from searches.variants import VARIANTS
from support import custom_actions, model

numbers = st.lists(st.integers(-5, 5).map(float), min_size=1, max_size=10)


def a_trial(share: float, steps: list[list[float]], seconds: float = 8.0) -> dict[str, object]:
    costs = {"nodes": 3, "transitions": 800, "generations": 4, "seconds": seconds}
    return {"solved": share == 1, "share": share, "fitness": share, **costs, "steps": steps}


@given(numbers)
def test_ranks_are_scipys(values: list[float]) -> None:
    assert midranks(torch.tensor(values).double().numpy()).tolist() == rankdata(values).tolist()


@given(st.lists(st.floats(-5, 5).filter(lambda x: abs(x) > 1e-3), min_size=1, max_size=9))
def test_without_ties_the_test_is_scipys_exact_one(values: list[float]) -> None:
    sizes = [abs(v) for v in values]
    if len(set(sizes)) == len(sizes):
        assert signed_rank(values) == pytest.approx(wilcoxon(values, method="exact").pvalue)


@given(numbers)
def test_the_test_is_symmetric_and_a_probability(values: list[float]) -> None:
    p = signed_rank(values)
    assert 0 < p <= 1
    assert signed_rank([-v for v in values]) == p


def test_facts_of_the_test() -> None:
    assert signed_rank([]) == signed_rank([0.0, 0.0]) == 1
    assert signed_rank([1.0] * 10) == 2 / 2**10
    assert signed_rank([1.0, -1.0]) == 1
    with pytest.raises(ValueError, match="21 differences"):
        signed_rank([1.0] * 21)


def test_share_on_the_way_is_the_area_below_the_steps() -> None:
    trial = a_trial(1.0, [[200, 1.0, 0.5, 0.5, 3], [600, 4.0, 1.0, 1.0, 3]])
    assert on_the_way(trial, "transitions", 1000) == pytest.approx(0.5 * 0.4 + 0.4)
    assert on_the_way(trial, "transitions", 400) == pytest.approx(0.25)
    assert on_the_way(trial, "seconds", 5) == pytest.approx(0.5 * 0.6 + 0.2)


def test_the_table_compares_seed_by_seed() -> None:
    slow = {i: a_trial(0.5, [[400 + i, 4.0, 0.5, 0.5, 3]]) for i in range(5)}
    fast = {i: a_trial(1.0, [[100 + i, 1.0, 1.0, 1.0, 3]]) for i in range(5)}
    lines = table({"slow": slow, "fast": fast, "untried": {}}, "slow").split("\n")
    assert len(lines) == 4
    assert "| slow | 0/5 | 50 (50–50) |" in lines[2]
    assert "| fast | 5/5 | 100 (100–100) |" in lines[3]
    assert lines[3].count(f"p {2 / 2**5:.2g}") == 2


@pytest.mark.parametrize("name", VARIANTS)
def test_a_trial_ends_at_its_cap_and_depends_on_its_seed_alone(name: str) -> None:
    def run(seed: int, cap: int) -> dict[str, object]:
        found = tried(VARIANTS[name], model(0, 3), custom_actions(), cap, seed)
        return {k: v for k, v in found.items() if k != "seconds"}

    first = run(1, 1)
    assert first["generations"] == 1
    assert [s[0] for s in first["steps"]] == [first["transitions"]]  # type: ignore[index,union-attr]
    again = run(1, 1)
    assert [s[2:] for s in first["steps"]] == [s[2:] for s in again["steps"]]  # type: ignore[index,union-attr]


def test_what_is_there_is_not_made_again(monkeypatch, tmp_path: Path) -> None:
    made = []

    def pose(problem: Problem, run: Path, seed: int):
        made.append(seed)
        return model(seed, 3), custom_actions()

    problems = {"small": Problem("percept", "perimeter", 3, 3, 1, 1)}
    monkeypatch.setattr(compare_search, "pose", pose)
    monkeypatch.setattr(compare_search, "PROBLEMS", problems)
    option = next(o for o in compare_search.main.params if o.name == "problems")
    monkeypatch.setattr(option, "type", click.Choice(list(problems)))
    arguments = [str(tmp_path), "--out", str(tmp_path / "out"), "--seeds", "0:2"]
    runner = click.testing.CliRunner()
    first = runner.invoke(compare_search.main, arguments, catch_exceptions=False)
    assert made == [0] * len(VARIANTS) + [1] * len(VARIANTS)
    again = runner.invoke(compare_search.main, arguments, catch_exceptions=False)
    assert len(made) == 2 * len(VARIANTS)
    assert first.output == again.output
    assert all(f"| {name} |" in first.output for name in VARIANTS)
