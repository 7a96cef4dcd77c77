"""What searches have cost, as tables."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, TypeAlias

from standard.measure import Result
from standard.tasks import TASKS

COSTS = {
    "evaluations": "evaluations",
    "episodes": "episodes",
    "world_steps": "world steps",
    "cpu_seconds": "CPU s",
}
"""The costs of a search, and their headings."""
HEADINGS = ("task", "library", "solved", *COSTS.values(), "note")

Summary: TypeAlias = dict[str, dict[str, dict[str, Any]]]
"""What has come out, by task and library."""


def summary(
    results: Sequence[Result],
    tasks: Sequence[str],
    libraries: Sequence[str],
    missing: Mapping[str, str],
) -> Summary:
    """For each task and library how many seeds have solved it, and at what costs these have.

    Medians and ranges are None where no seed has. Of libraries that are missing it is said why.
    """
    return {
        task: {
            library: _about(
                [each for each in results if (each.task, each.library) == (task, library)],
                missing.get(library, ""),
            )
            for library in libraries
        }
        for task in tasks
    }


def _about(results: Sequence[Result], note: str) -> dict[str, Any]:
    """What seeds of one library have made of one task."""
    good = [each for each in results if each.solved]
    about: dict[str, Any] = {
        "solved": len(good),
        "seeds": sum(each.evaluations > 0 for each in results),  # that were tried
    }
    for name in COSTS:
        about |= _spread(name, [getattr(each, name) for each in good])
    compiled = [each.compile_seconds for each in good if each.compile_seconds is not None]
    about["compile_seconds_median"] = median(compiled) if compiled else None
    about |= _spread("mean_return", [x for each in results if (x := each.mean_return) is not None])
    notes = dict.fromkeys([note, *(each.note for each in results)])
    about["note"] = "; ".join(each for each in notes if each)
    return about


def _spread(name: str, values: Sequence[float]) -> dict[str, Any]:
    """The median and the extremes."""
    if not values:
        return {f"{name}_median": None, f"{name}_range": None}
    return {f"{name}_median": median(values), f"{name}_range": [min(values), max(values)]}


def figure_rows(about: Summary, columns: Sequence[str]) -> list[list[str]]:
    """The table without what was not tried, with the costs that a figure has columns for."""
    shown = [name for name, heading in COSTS.items() if heading in columns]
    return [
        [TASKS[task].title, library, _solved(each), *(_costs(each, name) for name in shown)]
        for task, found in about.items()
        for library, each in found.items()
        if each["seeds"]
    ]


def markdown(about: Summary) -> str:
    """One row for each task and library."""
    rows = [HEADINGS, ("---",) * len(HEADINGS)]
    for task, found in about.items():
        rows += [_row(TASKS[task].title, library, each) for library, each in found.items()]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _row(title: str, library: str, about: Mapping[str, Any]) -> tuple[str, ...]:
    """A task and a library."""
    costs = [_costs(about, name) for name in COSTS]
    if about["compile_seconds_median"] is not None:
        costs[-1] += f", {about['compile_seconds_median']:.1f} of them compiling"
    return title, library, _solved(about), *costs, about["note"]


def _solved(about: Mapping[str, Any]) -> str:
    """How many seeds of those that were tried."""
    return f"{about['solved']} of {about['seeds']}" if about["seeds"] else "–"


def _costs(about: Mapping[str, Any], name: str) -> str:
    """The median, and the range if there is one."""
    if about[f"{name}_median"] is None:
        return "–"
    form = "{:,.1f}" if name == "cpu_seconds" else "{:,.0f}"
    spread = (about[f"{name}_median"], *about[f"{name}_range"])
    middle, low, high = map(form.format, spread)
    return middle if low == high else f"{middle} ({low}–{high})"
