"""The table of a comparison of methods: medians and ranges over seeds."""

import math
from statistics import median
from typing import Any

TARGETS = (0.85, 0.99)
COSTS = ("transitions", "seconds", "search_seconds")
LABELS = {
    "stages": "default, `--stage S3`",
    "auto": "default, `--stage auto`",
    "paper": "paper, its settings",
    "paper-here": "paper, our settings",
}


def summary(result: dict[str, Any]) -> str:
    """One line on one seed and method."""
    way = ", ".join(f"{p['stage']} {share(result, p):.1%}" for p in result["points"])
    return f"{way or 'nothing'}; {result['transitions'] / 1e6:.1f} M, {result['seconds']:.0f} s"


def share(result: dict[str, Any], point: dict[str, Any]) -> float:
    """Success on fresh placements."""
    return float(point["succeeded"] / result["placements"])


def cost_of(result: dict[str, Any], target: float, what: str) -> float:
    """What the first accepted skill that reaches the target had cost; infinity if none does."""
    reached = (p[what] for p in result["points"] if share(result, p) >= target)
    return float(next(reached, math.inf))


def table(results: list[dict[str, Any]]) -> str:
    """Medians and ranges over seeds, one row per method."""
    heads = ["method", "seeds", "success at the end", "evaluations, M", "CPU s (search)"]
    for target in TARGETS:
        heads += [f"{target:.0%}: seeds", "evaluations, M", "CPU s (search)"]
    lines = [heads, ["---"] * len(heads)]
    for name in LABELS:
        if of := [r for r in results if r["method"] == name]:
            last = [share(r, r["points"][-1]) if r["points"] else 0.0 for r in of]
            row = [LABELS[name], str(len(of)), spread([100 * x for x in last], "{:.1f} %")]
            row += _costs([{k: r[k] for k in COSTS} for r in of])
            for target in TARGETS:
                costs = [{k: cost_of(r, target, k) for k in COSTS} for r in of]
                row.append(f"{sum(math.isfinite(c['seconds']) for c in costs)} of {len(of)}")
                row += _costs(costs)
            lines.append(row)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _costs(costs: list[dict[str, float]]) -> list[str]:
    transitions, seconds, search = ([c[k] for c in costs] for k in COSTS)
    both = f"{spread(seconds, '{:.0f}')} ({spread(search, '{:.0f}')})"
    return [spread([t / 1e6 for t in transitions], "{:.1f}"), both]


def spread(values: list[float], form: str) -> str:
    """The median and the extremes; infinity is what was never reached."""
    middle, low, high = (
        form.format(v) if math.isfinite(v) else "never"
        for v in (median(values), min(values), max(values))
    )
    return middle if low == high else f"{middle}, {low}–{high}"
