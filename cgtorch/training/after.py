"""What to do about a training that has not reached its goal."""

from typing import Any

from cgtorch.domains.domain import Domain, Timed, rewarded
from cgtorch.ground.asked import Purse
from cgtorch.runs.chosen import folder_of_last
from cgtorch.runs.log import read_log
from cgtorch.runs.stored_run import StoredRun
from cgtorch.training.advice import about_search
from cgtorch.training.searched import searched_of

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


def unfinished(run: StoredRun) -> str:
    """What there is to say of a run whose first round has not ended in time, after its name."""
    searched, never = searched_of(read_log(run.folder), ""), ""
    if searched is not None and searched.generations:
        if not searched.solving:
            return f"has no skill that solves anything. {' '.join(about_search(searched))}"
        if not (rewarded(run.domain) or searched.imagined[0] or searched.met[0]):
            never = (
                f"; no individual of {searched.generations} generations has succeeded, so look "
                "whether success is possible"
            )
    best = "; the best skill so far is kept" if folder_of_last(run) else ""
    return f"has not finished its first round in time{never}{best}; {USUAL}"


def why_late(domain: Domain[Any], purse: Purse) -> str:
    """Why there is no skill at the end of the time, and what to do, as the end of a sentence."""
    if purse.unreturned:
        return f", as {purse.unreturned}; mend that"
    if advice := domain.pictures(domain).advice():
        return f", as {advice}"
    pace = f" ({domain.pace()})" if isinstance(domain, Timed) and domain.pace() else ""
    return f"{pace}; give more (minutes, --minutes)"


def only_return(log: list[dict[str, Any]]) -> float | None:
    """The return that all individuals of a search had, as its log says; None if they differ."""
    rows = [row for row in log if row["event"] == "generation"]
    found = {row[name] for row in rows for name in ("best", "mean", "low", "high")}
    return found.pop() if len(found) == 1 and None not in found else None
