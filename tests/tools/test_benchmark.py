"""The benchmark's own logic; what it measures is never a test."""

import importlib.metadata
import json
from dataclasses import replace

import benchmark
import click.testing
import pytest
import torch
from benchmarks.measure import (
    QUICK,
    Comparison,
    DisagreementError,
    Line,
    Timing,
    difference,
    in_turns,
    run_threads,
    torch_threads,
)

from cgtorch import native


def a_line(_) -> Line:
    times = Timing(1.0, 0.5, 2.0, 5), Timing(30.0, 20.0, 40.0, 5)
    parts = tuple(Comparison(f"{r}", *times, ratio=r, difference=0.0) for r in (30.0, 20.0))
    return Line("a", "ours / theirs", "x faster", 10.0, "CPU", 1, parts)


def an_upper_bound(_) -> Line:
    return replace(a_line(_), name="b", unit="of it", at_most=True)


def run(monkeypatch, lines, *arguments):
    monkeypatch.setattr(benchmark, "LINES", lines)
    monkeypatch.setattr(
        next(p for p in benchmark.main.params if p.name == "only"),
        "type",
        click.Choice(list(lines)),
    )
    return click.testing.CliRunner().invoke(benchmark.main, arguments)


def test_json_holds_the_worst_ratio_of_each_line_and_all_details(monkeypatch) -> None:
    found = json.loads(run(monkeypatch, {"a": a_line}, "--json").stdout)
    assert found["ratios"] == {"a": 20.0}
    assert found["lines"]["a"]["parts"][0]["ours"]["median"] == 1.0
    assert found["machine"]["cores"] >= 1
    assert found["versions"]["torch"] == importlib.metadata.version("torch")


def test_the_table_has_a_row_per_case_and_only_chooses(monkeypatch) -> None:
    lines = {"a": a_line, "b": lambda _: pytest.fail("not asked for")}
    result = run(monkeypatch, lines, "--only", "a", "--quick")
    assert result.exit_code == 0
    assert result.stdout.count("x faster") == 2


def test_where_less_is_better_the_worst_is_the_largest(monkeypatch) -> None:
    lines = {"a": a_line, "b": an_upper_bound}
    found = json.loads(run(monkeypatch, lines, "--json").stdout)
    assert found["ratios"] == {"a": 20.0, "b": 30.0}
    table = run(monkeypatch, lines).stdout
    assert table.count("≥ 10") == 2
    assert table.count("≤ 10") == 2


def test_notes_stand_below_the_table(monkeypatch) -> None:
    def noted(_) -> Line:
        line = a_line(_)
        return replace(line, parts=(replace(line.parts[0], note="7 rows/s [x]"), line.parts[1]))

    assert "a, 30.0: 7 rows/s [x]" in run(monkeypatch, {"a": noted}).stdout


def test_what_is_missing_or_differs_is_one_line(monkeypatch) -> None:
    def missing(_):
        raise ModuleNotFoundError("No module named 'sklearn'", name="sklearn")

    def wrong(_):
        difference(torch.zeros(3), torch.arange(3.0), 1e-3)

    assert "sklearn is missing" in run(monkeypatch, {"a": missing}).stderr
    assert "results differ" in run(monkeypatch, {"a": wrong}).stderr


def test_alternatives_are_timed_in_turns_after_a_call_that_is_not() -> None:
    seen = []
    ticks = iter(range(100))
    times = in_turns(
        [lambda: seen.append("a"), lambda: seen.append("b")],
        QUICK.repeats,
        clock=lambda: float(next(ticks)),
        calls=[1, 2],
    )
    assert "".join(seen) == "ab" + "abb" * 5
    assert [t.median for t in times] == [1.0, 0.5]
    assert times[0].repeats == 5


def test_results_are_compared_by_their_range() -> None:
    truth = torch.tensor([0.0, 100.0])
    assert difference(truth + 0.01, truth, 1e-3) == pytest.approx(1e-4, rel=1e-3)
    for wrong in (truth + 1, truth * float("nan"), truth[:1]):
        with pytest.raises(DisagreementError):
            difference(wrong, truth, 1e-3)


def test_threads_are_as_before_afterwards() -> None:
    before, compiled = torch.get_num_threads(), native.threads()
    with torch_threads(2):
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == before
    with run_threads(3):
        assert (torch.get_num_threads(), native.threads()) == (1, 3)
        with run_threads(2):
            assert native.threads() == 2
        assert (torch.get_num_threads(), native.threads()) == (1, 3)
    assert (torch.get_num_threads(), native.threads()) == (before, compiled)
