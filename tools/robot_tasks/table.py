"""The table of a comparison: medians over seeds for each task and search."""

from collections.abc import Mapping
from math import inf
from statistics import median
from typing import Any

HEADS = (
    "task", "search", "seeds", "criterion met", "requested", "simulated", "official", "seconds",
)  # fmt: skip


def table(results: list[dict[str, Any]], given: Mapping[str, str]) -> str:
    """Markdown; where the median seed has not met the criterion, the budget follows a ">"."""
    lines = [_row(HEADS), _row(["---"] * len(HEADS))]
    tasks = dict.fromkeys(result["task"] for result in results)
    for task in tasks:
        for search in given:
            some = [r for r in results if (r["task"], r["search"]) == (task, search)]
            if some:
                lines.append(_row([task, search, *_cells(some)]))
    lines += ["", "All have the same primitives, percepts, starts and episodes. Beyond these:", ""]
    lines += [f"- `{search}` is given {what}." for search, what in given.items()]
    return "\n".join(lines) + "\n"


def _cells(some: list[dict[str, Any]]) -> list[str]:
    met, few = sum(r["met"] for r in some), [r["official"] for r in some]
    share = median(good / tries for good, tries, _ in few)
    seconds = median(r["seconds"] for r in some)
    steps = [_steps(some, name) for name in ("requested", "simulated")]
    return [str(len(some)), f"{met} of {len(some)}", *steps, f"{share:.0%}", f"{seconds:.0f}"]


def _steps(some: list[dict[str, Any]], name: str) -> str:
    """The median of low-level steps up to the criterion, which some have not met."""
    steps = median(r[name] if r["met"] else inf for r in some)
    return f"{steps:,.0f}" if steps < inf else f"> {median(r[name] for r in some):,.0f}"


def _row(cells: Any) -> str:
    return f"| {' | '.join(cells)} |"
