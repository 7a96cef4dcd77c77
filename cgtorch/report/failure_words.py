"""Why a skill fails, in words and as plain data: what the report, the files and JSON have of it."""

import itertools
from collections.abc import Sequence
from math import isfinite
from typing import Any

from torch import Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.failures import CAUSES, Failure, Failures
from cgtorch.domains.way import Act, Motion, Way
from cgtorch.ground.errors import printable
from cgtorch.ground.fields import Field

SHOWN = 12  # scenarios of a kind that are named
NUMBERS = 8  # of a percept or control that are shown
FIRST, LAST = 30, 10  # steps of a way that are in the text
ERRS = "An error of Γ of 1 is large: for 99 % of its data it is smaller."
COLUMNS = ("step", "node → outcome", "control", "percept afterwards", "C says", "Γ errs")

Fields = Sequence[Field]


def which_fail(found: Failures) -> list[str]:
    """Sentences about which scenarios fail."""
    if not found.tried:
        return ["There is no skill yet that could be tried on fresh scenarios."]
    total = sum(each.tried for each in found.tried)
    said = [f"{found.failed} of {total} scenarios fail."]
    if len(found.tried) > 1:
        parts = [
            f"{t.tried - t.succeeded} of {t.tried} {t.kind}"
            + ("" if t.made else " (for which no skill was found yet)")
            for t in found.tried
        ]
        said.append(f"By kind: {', '.join(parts)}.")
    if 0 < found.looked < found.failed:
        said.append(f"{found.looked} of them were looked at.")
    if 0 < (caused := sum(found.causes().values())) < found.failed:
        said.append(f"For {caused} of them, the first of each kind, the causes were looked for.")
    if (split := found.split) is not None:
        beyond = "more" if split.above else "less"
        (failed, failures), (solved, successes) = split.failed, split.solved
        said.append(
            f"Failures and successes begin in different places: {split.name} is {beyond} than "
            f"{in_unit(split.threshold, split.unit)} in {failed} of {failures} failures, and in "
            f"{solved} of {successes} successes."
        )
    return said


def title_of(kind: Failure) -> str:
    """A kind of failure in short."""
    short = bool(kind.returns) and isfinite(kind.returns[0])
    return f"{'return below the target' if short else kind.end}, ending at {kind.node}"


def about_kind(found: Failures, kind: Failure, domain: Domain[Any]) -> list[str]:
    """Sentences about a kind of failure: how many, why, and where prediction and world part."""
    others = len(kind.scenarios) - 1
    likewise = f"{others} others failed likewise" if others != 1 else "another failed likewise"
    numbers = ", ".join(map(found.label, kind.scenarios[1 : 1 + SHOWN]))
    more = ", …" if others > SHOWN else ""
    said = [
        f"This is scenario {found.label(kind.scenarios[0])}; "
        + (f"{likewise} ({numbers}{more})." if others else "no other failed likewise.")
    ]
    if kind.returns:
        over = isfinite(kind.returns[0])
        said.append(
            f"Its return is {kind.returns[0]:.5g}."
            if over
            else "It has no return, as the skill ends before the episode does."
        )
    looked = sum(len(cause.scenarios) for cause in kind.causes)
    causes = [f"{len(c.scenarios)} of {looked}: {CAUSES[c.name]}" for c in kind.causes]
    said.append(f"Why: {'; '.join(causes)}.")
    way, steps = kind.way, len(kind.way.acts)
    said.append(course_of(way))
    if kind.end == "timeout" and 2 * way.still < steps and kind.causes[0].name != "limit":
        since = f"From step {way.still} on" if way.still else "In all steps"
        said.append(
            f"{since} the skill goes round without a control, so more transitions will hardly help."
        )
    if way.parts is not None:
        said.append(apart(way, domain.percept))
    return said


def course_of(way: Way) -> str:
    """What the skill did in short: its steps, what became of controls, and how often it ended so.

    Controls within a skill that is a node count one by one.
    """
    steps = len(way.acts)
    done = sum(len(act.motions) for act in way.acts)
    refused = sum(act.refused is not None for act in way.acts)
    were = "control was" if done == 1 else "controls were"
    said = [f"In {steps} step{'s' if steps != 1 else ''} {done} {were} carried out"]
    if refused:
        said.append(f" and {refused} refused")
    last = way.acts[-1]
    same = sum((act.node, act.outcome) == (last.node, last.outcome) for act in way.acts)
    if same > 1:
        said.append(f"; {same} of the steps were {last.node} → {last.outcome}")
    return "".join(said) + "."


def apart(way: Way, fields: Fields) -> str:
    """Where prediction and world part in a way, and in which numbers of the percept."""
    assert way.parts is not None  # noqa: S101  the caller has asked
    motion = max(way.acts[way.parts].motions, key=lambda m: m.error or 0)
    said = f"Prediction and world part in step {way.parts}"
    if motion.errors is None or motion.predicted is None:
        return f"{said}."
    parts = list[str]()
    for d in motion.errors.argsort(descending=True).tolist()[:3]:
        if parts and motion.errors[d] <= 1:
            break
        name, unit = named(fields, len(motion.errors))[d]
        was, now = (in_unit(float(x[d]), unit) for x in (motion.predicted, motion.became))
        times = float(motion.errors[d])
        parts.append(
            f"{name} is {now} where Γ says {was}, {times:.2g} times its usual largest error"
        )
    return f"{said}: {'; '.join(parts)}."


def table_of(way: Way, domain: Domain[Any], first: int, last: int) -> list[tuple[str, ...]]:
    """A table of the first and the last steps of a way, its head first, without empty columns."""
    rows, before, parts = list[tuple[str, ...]](), way.first, way.parts
    shown = ("start", "", "", numbers_in(way.first, domain.percept), "", "")
    rows.append(shown)
    for i, act in enumerate(way.acts):
        if i < first or i >= len(way.acts) - last:
            same = bool((act.percept == before).all())
            seen = "as before" if same else numbers_in(act.percept, domain.percept)
            mark = f"{i} (parts here)" if i == parts else str(i)
            control = "; ".join(numbers_in(m.control, domain.control) for m in act.motions)
            if act.refused is not None:
                control = f"refused: {numbers_in(act.refused, domain.control)}"
            rows.append((mark, f"{act.node} → {act.outcome}", control, seen, *said_of(act)))
        elif i == first:
            rows.append(("…", f"{len(way.acts) - first - last} more steps", "", "", "", ""))
        before = act.percept
    filled = [any(column) for column in zip(*rows, strict=True)]
    return [tuple(itertools.compress(row, filled)) for row in (COLUMNS, *rows)]


def said_of(act: Act) -> tuple[str, str]:
    """What C and Γ say of an action."""
    errors = [motion.error for motion in act.motions if motion.error is not None]
    chance = "" if act.chance is None else f"{act.chance:.2f}"
    return chance, f"{max(errors):.2g}" if errors else ""


def named(fields: Fields, size: int) -> list[tuple[str, str]]:
    """Names and units of numbers; those of another length than the domain's are numbered."""
    if len(fields) != size:
        return [(str(i), "") for i in range(size)]
    return [(field.name, field.unit) for field in fields]


def in_unit(value: float, unit: str) -> str:
    """A number with its unit."""
    return f"{value:.3g} {unit}".rstrip()


def numbers_in(values: Tensor, fields: Fields) -> str:
    """Numbers with their names and units, up to `NUMBERS`."""
    known = zip(named(fields, len(values)), values.tolist(), strict=True)
    parts = [f"{name} {in_unit(value, unit)}" for (name, unit), value in known]
    more = len(parts) - NUMBERS
    return ", ".join(parts[:NUMBERS]) + (f", and {more} more" if more > 0 else "")


def most_of(found: Failures) -> int:
    """The number of failures of which advice counts some."""
    return max(sum(found.causes().values()), *(each.count for each in found.advice), 0)


def as_text(found: Failures, domain: Domain[Any], films: dict[int, str]) -> str:
    """All of it as Markdown; `films` are the files of films, by the number of the kind."""
    lines = [
        f"# Why {found.skill} fails",
        "",
        "**Which scenarios fail?** " + " ".join(which_fail(found)),
    ]
    if found.blame:
        lines += ["", f"**Is Γ or the search to blame?** {found.blame}"]
    if found.advice:
        lines += ["", "**What should I change?**", ""]
        looked = most_of(found)
        lines += [f"- {each.count} of {looked}: {each.text}" for each in found.advice]
    for number, kind in enumerate(found.kinds, 1):
        lines += [
            "",
            f"## {number}. {title_of(kind)}",
            "",
            " ".join(about_kind(found, kind, domain)),
        ]
        if number in films:
            lines += ["", f"![The skill at work]({films[number]})"]
        head, *rows = table_of(kind.way, domain, FIRST, LAST)
        lines += ["", *map(_line, (head, ["---"] * len(head), *rows))]
    lines += ["", ERRS]
    return "\n".join(map(printable, lines)) + "\n"


def _line(cells: Sequence[str]) -> str:
    """A line of a table, in which nothing but its rims is a rim."""
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def as_data(found: Failures, domain: Domain[Any]) -> dict[str, Any]:
    """All of it as plain data, with numbers by the names of their fields."""
    return {
        "skill": found.skill,
        "tried": [vars(each) for each in found.tried],
        "failed": found.failed,
        "looked": found.looked,
        "lucky": found.lucky,
        "split": found.split and vars(found.split),
        "causes": found.causes(),
        "blame": found.blame,
        "advice": [vars(each) for each in found.advice],
        "kinds": [_kind_as_data(kind, domain) for kind in found.kinds],
    }


def _kind_as_data(kind: Failure, domain: Domain[Any]) -> dict[str, Any]:
    return {
        "end": kind.end,
        "node": kind.node,
        "scenarios": list(kind.scenarios),
        "causes": {cause.name: list(cause.scenarios) for cause in kind.causes},
        "returns": [finite(value) for value in kind.returns],
        "parts": kind.way.parts,
        "first": _by_name(kind.way.first, domain.percept),
        "way": [
            {
                "node": act.node,
                "outcome": act.outcome,
                "chance": act.chance,
                "percept": _by_name(act.percept, domain.percept),
                "refused": _by_name(act.refused, domain.control),
                "motions": [_motion_as_data(motion, domain) for motion in act.motions],
            }
            for act in kind.way.acts
        ],
    }


def _motion_as_data(motion: Motion, domain: Domain[Any]) -> dict[str, Any]:
    return {
        "control": _by_name(motion.control, domain.control),
        "became": _by_name(motion.became, domain.percept),
        "predicted": _by_name(motion.predicted, domain.percept),
        "error": motion.error,
        "errors": _by_name(motion.errors, domain.percept),
        "novelty": motion.novelty,
    }


def _by_name(values: Tensor | None, fields: Fields) -> dict[str, float | None] | None:
    if values is None:
        return None
    names = [name for name, _ in named(fields, len(values))]
    return dict(zip(names, map(finite, values.tolist()), strict=True))


def finite(value: float) -> float | None:
    """The number, None if it is not finite, as JSON has no such numbers."""
    return value if isfinite(value) else None
