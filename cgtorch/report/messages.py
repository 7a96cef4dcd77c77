"""Texts on the screen: a line for each event, without colour, and the table of stages."""

from collections.abc import Mapping, Sequence
from math import floor, log10
from typing import TYPE_CHECKING, Any, Literal

from cgtorch.ground.asked import Purse
from cgtorch.ground.errors import printable
from cgtorch.improvement import events
from cgtorch.improvement.imagined_state import RANDOM
from cgtorch.runs.stored_run import AUTO

if TYPE_CHECKING:
    from rich.table import Table

    from cgtorch.domains.domain import Domain

SECONDS = 30  # of a robot's motion or grasp, with all that belongs to it
MISSING = "–"

Result = Mapping[str, Any]
"""The result of a stage, as in the log."""


def message_of(event: events.Event) -> str:
    """The message of an event, "" if it has none."""
    match event:
        case events.StageStarted():
            return (
                f"{event.stage}: {place_of(event)}, "
                f"{event.size_w} scenarios to keep (W), {event.size_m} to solve"
            )
        case events.EvolutionRecalled():
            known = event.found.generations
            return f"{event.candidate}: {known} generations are already in the journal"
        case events.JournalDamaged():
            files = ", ".join(event.files)
            return f"{event.stage}: damaged files, whose work is repeated: {files}"
        case events.StageFailed():
            return (
                f"{event.stage}: no skill keeps W and solves more after {event.attempts} attempts; "
                "the stage comes back if another one is made"
            )
        case events.ModelsFitted():
            return f"{event.stage}: {event.summary.text}, {event.seconds:.1f} s"
        case events.WorldTested():
            return _world_tested(event)
        case events.WorldAsked():
            silent = event.phase in ("looks", "search")
            return "" if silent else f"{event.stage}: {_asked(event)}"
        case events.ChanceFound():
            share = event.succeeded / event.tried
            return (
                f"{event.stage}: under other noise the same skill solves {share:.0%} of the "
                f"{event.tried} scenarios that it solved: this world is chance; from now on skills "
                "are evolved in it on fresh scenarios, and means count (--chance no overrules it)"
            )
        case events.MeanTested():
            return (
                f"{event.stage}: mean {mean_text(event.mean, event.error)} on {event.tried:,} "
                f"fresh episodes; {event.scenarios} in each generation, {event.episodes:,} played"
            )
        case events.EpisodePlayed():
            return (
                f"{event.stage}: {event.phase}, an episode in the world of {event.steps} steps "
                f"with return {mean_text(event.returned, None)}; {event.total:,} steps so far"
            )
        case events.Practised():
            return (
                f"{event.skill.name}: {event.in_a_row} of {event.wanted} fresh scenarios solved in "
                "a row"
            )
        case events.SkillAccepted():
            return _skill_accepted(event)
        case events.FreshTested():
            share = event.succeeded / max(1, event.tried)
            kind = "final test, " if event.decisive else ""
            if event.skill != event.stage and not event.decisive:
                kind = f"no skill was accepted; {event.skill} was tested again, "
            solved = f"{event.succeeded} of {event.tried} fresh scenarios = {share:.1%}"
            if event.mean_return is not None:
                mean = mean_text(event.mean_return, event.error)
                solved = f"mean return {mean} on {event.tried} fresh episodes"
            return f"{event.stage}: {kind}{solved}, the goal is {event.target:.4g}"
    return ""


def mean_text(mean: float | None, error: float | None) -> str:
    """A mean with two standard errors, such as "2.86 ± 0.02", up to their first digit.

    In a very small or large unit it is such as "2.86e-12 ± 2e-14".
    """
    if mean is None:
        return MISSING
    if not error:
        return f"{mean:.5g}" + (" ± 0" if error == 0 else "")
    digits = -floor(log10(2 * error))
    if mean and abs(digits) > 6:
        return f"{mean:.{max(0, digits + floor(log10(abs(mean))))}e} ± {2 * error:.0e}"
    digits = min(6, max(0, digits))
    return f"{mean:.{digits}f} ± {2 * error:.{digits}f}"


def _asked(event: events.WorldAsked) -> str:
    asked = event.asked
    tried = f", {event.succeeded} of {asked.episodes} succeeded" if asked.episodes else ""
    what = f"{asked.motions} motions and {asked.tests} tests"
    if asked.steps:
        what = f"{asked.steps} low-level steps, {asked.simulated} of them simulated"
    return f"{event.phase}: {what}{tried}"


def asked_of(whom: str, purse: Purse) -> str:
    """World actions of all phases, and the time that a robot takes for them."""
    total = purse.total
    if total.steps:
        phases = ", ".join(f"{phase} {a.steps}" for phase, a in purse.spent.items() if a.steps)
        return (
            f"asked of the {whom}: {total.steps} low-level steps ({phases}), of which "
            f"{total.simulated} had to be simulated, in {total.episodes} trials and a search"
        )
    if total.motions and whom == "world" and RANDOM in purse.spent:
        phases = ", ".join(f"{phase} {a.motions}" for phase, a in purse.spent.items() if a.motions)
        return (
            f"asked of the world: {total.motions:,} steps ({phases}) in {total.episodes} episodes, "
            f"and {total.looks} first percepts; fresh episodes of tests are not among them"
        )
    if not total.actions:
        return f"asked of the {whom}: no motions and no tests; {total.looks} scenes were looked at"
    hours = total.actions * SECONDS / 3600
    phases = ", ".join(f"{phase} {a.actions}" for phase, a in purse.spent.items() if a.actions)
    return (
        f"asked of the {whom}: {total.motions} motions, {total.tests} tests, {hours:.1f} h at "
        f"{SECONDS} s ({phases}); {total.looks} scenes were looked at"
    )


def few_solved(tried: int, solved: int) -> str:
    """The message that few of the episodes succeeded for which skills were evolved."""
    return (
        f"of {tried} episodes that skills were evolved for, {solved} succeeded in the world: Γ or "
        "C is wrong where the search goes; see 'When it does not learn' in docs/own-domain.md"
    )


def _world_tested(event: events.WorldTested) -> str:
    text = (
        f"{event.candidate}: in the world W {event.solved_w}/{event.size_w}, "
        f"M {event.solved_m}/{event.size_m}"
    )
    if event.solved_w < event.size_w:
        text += "; not accepted, as it loses some of W; the search goes on"
    return text


def _skill_accepted(event: events.SkillAccepted[Any]) -> str:
    w, targets = event.succeeded[event.keep], event.targets
    others, some = event.succeeded[~event.keep], len(event.succeeded) > 0
    nodes = f"{event.skill.num_nodes} node{'s' if event.skill.num_nodes != 1 else ''}"
    tests = f"tests {int(event.succeeded[targets].sum())}/{int(targets.sum())}"
    parts = [
        *([tests] if int(targets.sum()) < len(others) else []),  # in a round, M is the test
        *([f"W {int(w.sum())}/{len(w)}", f"M {int(others.sum())}/{len(others)}"] if some else []),
        f"{nodes} in {event.skill.depth} level{'s' if event.skill.depth != 1 else ''}",
        as_time(event.seconds),
    ]
    return f"{event.stage}: accepted; {', '.join(parts)}"


def stage_number(event: events.StageStarted) -> tuple[int, int]:
    """The number of the stage in the run, from 1, and the number of stages."""
    known = event.stage in event.stages
    return (event.stages.index(event.stage) + 1 if known else 1), max(len(event.stages), 1)


def place_of(event: events.StageStarted) -> str:
    """The place of a stage in its run, such as "stage 2 of 3" or "round 1"."""
    if event.stage.startswith(f"{AUTO}-"):
        return f"round {event.stage.removeprefix(f'{AUTO}-')}"
    number, count = stage_number(event)
    return f"stage {number} of {count}"


def as_time(seconds: float) -> str:
    """Seconds as 0:07, 12:05 or 1:02:30; files have tenths, which give the same text."""
    whole = int(round(seconds, 1) + 0.5)
    hours, minutes = divmod(whole // 60, 60)
    text = f"{minutes}:{whole % 60:02d}"
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else text


def final_table(results: Sequence[Result], domain: "Domain[Any]") -> "Table":
    """The results of stages, and below them the last test on all kinds of scenarios.

    A missing value is a dash. There is a column of published results only if there are any.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    pictures = domain.pictures(domain)
    table = Table(
        title=pictures.solved[1], title_justify="left", header_style="bold", box=SIMPLE_HEAD,
        caption=Text(printable(_overall(results, domain))), caption_justify="left",
        caption_style="", pad_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    beside = ["ours", pictures.publisher] if pictures.published else ["solved"]
    texts = ["stage", "scenarios", *beside]
    for name in (*texts, "W kept", "fresh", "nodes", "gens", "time"):
        justify: Literal["left", "right"] = "left" if name in texts else "right"
        table.add_column(name, justify=justify, no_wrap=True)
    for result in results:
        table.add_row(*(Text(printable(cell)) for cell in _row(result, domain)))
    return table


def _row(result: Result, domain: "Domain[Any]") -> list[str]:
    every = domain.pictures.published
    published = every.get(str(result.get("stage")))
    size, lost = result.get("w_size"), result.get("w_lost")
    return [
        _text(result, "stage"),
        _text(result, "scenarios"),
        _share(result, "targets_succeeded", "targets") if result.get("targets") else MISSING,
        *([published.text if published else MISSING] if every else []),
        MISSING if size is None or lost is None else f"{size - lost}/{size}",
        _share(result.get("fresh") or {}, "succeeded", "tried"),
        _text(result, "nodes"),
        _text(result, "generations"),
        MISSING if result.get("seconds") is None else as_time(result["seconds"]),
    ]


def _overall(results: Sequence[Result], domain: "Domain[Any]") -> str:
    """A line on the last test on all kinds of scenarios, and on what is published; "" if none."""
    tested = [r for r in results if r.get("overall")]
    if not tested:
        return ""
    last = tested[-1]["overall"]
    kind = last.get("scenarios", domain.kinds[0])
    ours = _share(last, "succeeded", "tried")
    if last.get("tried"):
        ours += f" = {100 * last['succeeded'] / last['tried']:.3g} %"
    if last.get("mean_return") is not None:
        ours += f", mean return {mean_text(last['mean_return'], last.get('error'))}"
    said = f"{_text(tested[-1], 'stage')} on {kind}: {ours}."
    pictures = domain.pictures
    theirs = pictures.published.get("") if kind == domain.kinds[0] else None
    if theirs:
        after = f" after {[*domain.stages][-1]}" if domain.stages else ""
        share = f"{theirs.text} = {100 * theirs.succeeded / theirs.tried:.3g} %"
        publisher = pictures.publisher[:1].upper() + pictures.publisher[1:]
        said += f" {publisher}{after}: {share}."
    return said


def _text(data: Mapping[str, Any], key: str) -> str:
    return MISSING if data.get(key) is None else str(data[key])


def _share(data: Mapping[str, Any], part: str, whole: str) -> str:
    if data.get(part) is None or data.get(whole) is None:
        return MISSING
    return f"{data[part]}/{data[whole]}"
