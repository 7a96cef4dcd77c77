"""What to do about a training in rounds that has not reached its goal."""

from typing import Any

from cgtorch.domains.domain import rewarded
from cgtorch.runs.log import read_log
from cgtorch.runs.stored_run import StoredRun

USUAL = "continue with --resume"


def advice_after(run: StoredRun) -> str:
    """What to do next, as the end of a sentence; usually the search just goes on."""
    if advice := run.domain.pictures(run.domain).advice():
        return advice
    if run.imagines or not rewarded(run.domain):
        return USUAL
    value = only_return(read_log(run.folder))
    if value is None:
        return USUAL
    return (
        f"all individuals of all generations had a return of {value:.4g}, so nothing shows the "
        "search the way: give rewards for progress (in the environment, or by --wrappers), and "
        "train anew"
    )


def only_return(log: list[dict[str, Any]]) -> float | None:
    """The return that all individuals of a search had, as its log says; None if they differ."""
    rows = [row for row in log if row["event"] == "generation"]
    found = {row[name] for row in rows for name in ("best", "mean", "low", "high")}
    return found.pop() if len(found) == 1 and None not in found else None
