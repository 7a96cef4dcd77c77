"""The trials of several searches as a Markdown table."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, TypeAlias

from searches.statistics import quartiles, signed_rank

Trials: TypeAlias = Mapping[int, Mapping[str, Any]]
"""What `searches.trial.tried` gave, by seed."""

HEADINGS = (
    "search", "solved", "solved share, %", "M transitions", "generations", "CPU s", "nodes",
    "on the way, %", "the same by CPU, %",
)  # fmt: skip
CLOCKS = {"transitions": 0, "seconds": 1}
"""Where each is in a step of a trial."""


def on_the_way(trial: Mapping[str, Any], clock: str, horizon: float) -> float:
    """Mean solved share from the first transition, or second, to the horizon.

    What has been solved stays so, also beyond the trial's end. It is higher for a search that
    solves everything sooner, and among those that do not, for one that solves more.
    """
    area, since, share = 0.0, 0.0, 0.0
    for step in trial["steps"]:
        now = min(step[CLOCKS[clock]], horizon)
        area, since, share = area + share * (now - since), now, step[2]
    return (area + share * (horizon - since)) / horizon


def table(trials: Mapping[str, Trials], base: str) -> str:
    """Markdown with one row for each search, the base first.

    Medians with quartiles; p of Wilcoxon's signed-rank test against the base, seed by seed. The
    horizons are the most transitions and the median CPU time of the base's trials that were
    stopped, of all if none was.
    """
    stopped = [t for t in trials[base].values() if not t["solved"]] or [*trials[base].values()]
    horizons = {
        "transitions": max(t["transitions"] for t in stopped),
        "seconds": median(t["seconds"] for t in stopped),
    }
    names = [base, *(name for name in trials if name != base and trials[name])]
    rows = [_row(name, trials[name], trials[base], horizons) for name in names]
    lines = [HEADINGS, ("---",) * len(HEADINGS), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _row(name: str, tried: Trials, base: Trials, horizons: Mapping[str, float]) -> Sequence[str]:
    column = {key: [t[key] for t in tried.values()] for key in next(iter(tried.values()))}
    return (
        name,
        f"{sum(column['solved'])}/{len(tried)}",
        _spread([100 * share for share in column["share"]], 0),
        _spread([count / 1e6 for count in column["transitions"]], 2),
        _spread(column["generations"], 0),
        _spread(column["seconds"], 1),
        _spread(column["nodes"], 0),
        *(_compared(tried, base, clock, horizons[clock]) for clock in CLOCKS),
    )


def _compared(tried: Trials, base: Trials, clock: str, horizon: float) -> str:
    mine = {seed: on_the_way(t, clock, horizon) for seed, t in tried.items()}
    said = _spread([100 * x for x in mine.values()], 0)
    if tried is base:
        return said
    both = [seed for seed in tried if seed in base]
    gains = [mine[seed] - on_the_way(base[seed], clock, horizon) for seed in both]
    return f"{said}, p {signed_rank(gains):.2g}"


def _spread(values: Sequence[float], digits: int) -> str:
    low, middle, high = quartiles(values)
    return f"{middle:.{digits}f} ({low:.{digits}f}–{high:.{digits}f})"
