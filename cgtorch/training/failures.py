"""Why a skill fails: each kind of failure once, with its way through the graph.

Failures are of one kind if the skill ends in the same way, at the same node, with the same outcome
of its last action.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.film import WIDTH, animated
from cgtorch.domains.knowledge import Knowledge
from cgtorch.graphs import Skill
from cgtorch.ground.environment import Live
from cgtorch.ground.errors import CgtorchError, SettingsError
from cgtorch.ground.fields import Field
from cgtorch.ground.files import write_bytes, write_json
from cgtorch.simulation import Recording, Step, Traced, traced
from cgtorch.simulation.tracing import name_of
from cgtorch.training.evaluate import Score

MOST = 200  # failures that are looked at
SHOWN = 12  # scenarios of a kind that are named in the text
FIRST, LAST = 30, 10  # steps of a way that are in the text
USUAL = 0.99  # share of the data on which Γ errs less than where prediction and world part
ROWS = 1000  # of the data, on which that is measured


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Motion:
    """A control (U,), the percept (D,) that followed, and what Γ says; None without models.

    `error` is that of the prediction, in units of what is exceeded by few of Γ's data.
    """

    control: Tensor
    became: Tensor
    predicted: Tensor | None = None
    error: float | None = None


@dataclass(frozen=True, eq=False)
class Act:
    """An action of a node: its outcome, the percept (D,) afterwards, and its motions.

    `node` names the nodes that contain it, outermost first, with their slots. `chance` is what C
    says of the percept; None without models.
    """

    node: str
    outcome: str
    percept: Tensor
    motions: tuple[Motion, ...]
    chance: float | None = None


@dataclass(frozen=True, eq=False)
class Failure:
    """A kind of failure.

    Attributes:
        end: failure or timeout.
        node: Where the skill ended, as in `Act`, with the outcome.
        scenarios: The numbers of the scenarios that failed in this way. The first is the example.
        first: (D,) the first percept of the example.
        way: What the skill did there.
        parts: The number in `way` of the first action in which the world did something that Γ had
            not predicted; None if there is none, or without models.
    """

    end: str
    node: str
    scenarios: tuple[int, ...]
    first: Tensor
    way: tuple[Act, ...]
    parts: int | None


def failures_of(
    skill: Skill, domain: Domain[Any], score: Score, knowledge: Knowledge | None = None
) -> list[Failure]:
    """The kinds of failure in a score, the most frequent first, from up to `MOST` failures.

    Scenarios that succeed when they are met again are left out. With Γ and C of the skill's run,
    it is told what they say. SettingsError if the world is a robot, which cannot be put back.
    """
    found = dict[tuple[str, str], list[int]]()
    examples = dict[tuple[str, str], tuple[Traced, Recording]]()
    for row in (~score.succeeded).nonzero()[:MOST, 0].tolist():
        world = domain.world(score.scenarios[row : row + 1])
        if isinstance(world, Live):
            raise SettingsError(
                "a robot cannot be put back to where it failed; find failures in a simulated world"
            )
        place = Recording(world)
        with torch.no_grad():
            run = traced(skill, place)
        if run.end == "success":
            continue
        last = run.steps[-1]
        kind = run.end, f"{node_of(last)}: {last.outcome}"
        found.setdefault(kind, []).append(row)
        examples.setdefault(kind, (run, place))
    kinds = sorted(found, key=lambda kind: -len(found[kind]))
    judge = _Judge(knowledge)
    return [_failure(kind, found[kind], *examples[kind], judge) for kind in kinds]


class _Judge:
    """What Γ and C say, if they are known."""

    def __init__(self, knowledge: Knowledge | None) -> None:
        self._known, self._usual = knowledge, 1.0
        if knowledge is not None:
            data, gamma = knowledge.dataset, knowledge.gamma
            p, u, q = (x[:ROWS] for x in (data.percept, data.control, data.next_percept))
            with torch.no_grad():
                self._usual = max(1e-9, float(gamma.errors(gamma(p, u), q).quantile(USUAL)))

    def of_motion(self, before: Tensor, control: Tensor, became: Tensor) -> Motion:
        """A motion, with what Γ says."""
        if self._known is None:
            return Motion(control, became)
        gamma = self._known.gamma
        with torch.no_grad():
            predicted = gamma(before[None], control[None])
            error = float(gamma.errors(predicted, became[None])) / self._usual
        return Motion(control, became, predicted[0], error)

    def chance(self, percept: Tensor) -> float | None:
        """C(p)."""
        if self._known is None:
            return None
        with torch.no_grad():
            return float(self._known.classifier(percept[None]))


def _failure(
    kind: tuple[str, str], rows: list[int], run: Traced, place: Recording, judge: _Judge
) -> Failure:
    motions = [
        (int(key), judge.of_motion(p, u, q))
        for keys, *columns in place.transitions
        for key, p, u, q in zip(keys, *columns, strict=True)
    ]
    way = []
    for number, (step, after) in enumerate(zip(run.steps, run.lanes[1:], strict=True)):
        some = tuple(motion for key, motion in motions if key == number)
        percept = after.percept[0]
        way.append(Act(node_of(step), step.outcome, percept, some, judge.chance(percept)))
    parts = [any((m.error or 0) > 1 for m in act.motions) for act in way]
    return Failure(
        *kind, tuple(rows), run.lanes[0].percept[0], tuple(way),
        parts.index(True) if any(parts) else None,
    )  # fmt: skip


def node_of(step: Step) -> str:
    """The nodes that contain a step, outermost first, with their slots."""
    return " > ".join(f"{name_of(skill, slot)}_{slot}" for skill, slot in step.places)


def write_failures(
    folder: Path, skill: Skill, domain: Domain[Any], score: Score, kinds: Sequence[Failure]
) -> list[Path]:
    """Write failures.md, failures.json, and a film of each example where the domain can draw."""
    folder.mkdir(parents=True, exist_ok=True)
    films, pictures = dict[int, str](), domain.pictures(domain)
    for number, kind in enumerate(kinds, 1):
        one = score.scenarios[kind.scenarios[0] : kind.scenarios[0] + 1]
        try:
            film = pictures.film(skill, one, WIDTH)
        except CgtorchError:  # this machine cannot draw, and to try again may end the process
            film = None
        if film is None:
            break
        films[number] = f"kind-{number}.webp"
        write_bytes(folder / films[number], animated([film], "webp"))
    names = domain.percept, domain.control
    data = [
        {**as_data(kind, *names), "film": films.get(number)} for number, kind in enumerate(kinds, 1)
    ]
    write_json(folder / "failures.json", {"skill": skill.name, "kinds": data})
    text = as_text(skill.name, score, kinds, domain.control, films)
    write_bytes(folder / "failures.md", text.encode())
    return [folder / name for name in ("failures.md", "failures.json", *films.values())]


def as_data(kind: Failure, percept: Sequence[Field], control: Sequence[Field]) -> dict[str, Any]:
    """A kind of failure as plain data, with numbers by the names of their fields."""

    def seen(values: Tensor | None) -> dict[str, float] | None:
        return None if values is None else _named(values, percept)

    return {
        "end": kind.end,
        "node": kind.node,
        "scenarios": list(kind.scenarios),
        "parts": kind.parts,
        "first": seen(kind.first),
        "way": [
            {
                "node": act.node,
                "outcome": act.outcome,
                "chance": act.chance,
                "percept": seen(act.percept),
                "motions": [
                    {
                        "control": _named(motion.control, control),
                        "became": seen(motion.became),
                        "predicted": seen(motion.predicted),
                        "error": motion.error,
                    }
                    for motion in act.motions
                ],
            }
            for act in kind.way
        ],
    }


def _named(values: Tensor, fields: Sequence[Field]) -> dict[str, float]:
    """Numbers by field; percepts of another length than the domain's are numbered."""
    names = [field.name for field in fields]
    if len(names) != len(values):
        names = [str(i) for i in range(len(values))]
    return dict(zip(names, values.tolist(), strict=True))


def as_text(
    name: str,
    score: Score,
    kinds: Sequence[Failure],
    control: Sequence[Field],
    films: dict[int, str],
) -> str:
    """All kinds of failure as Markdown."""
    failed, looked = score.tried - score.successes, sum(len(kind.scenarios) for kind in kinds)
    lines = [f"# Why {name} fails", "", f"{failed} of {score.tried} scenarios failed."]
    if looked < failed:
        lines[-1] += f" {looked} of them were looked at."
    for number, kind in enumerate(kinds, 1):
        some = ", ".join(str(row) for row in kind.scenarios[:SHOWN])
        more = ", ..." if len(kind.scenarios) > SHOWN else ""
        lines += ["", f"## {number}. {kind.end} at {kind.node}", ""]
        lines.append(f"{len(kind.scenarios)} scenarios: {some}{more}.")
        lines.append(f"This is what the skill did in number {kind.scenarios[0]}:")
        if number in films:
            lines += ["", f"![The skill at work]({films[number]})"]
        lines += ["", *_table(kind)]
        if kind.parts is not None:
            lines += ["", f"Prediction and world part in step {kind.parts}."]
    lines += ["", f"A control is {', '.join(field.name for field in control)}."]
    lines += ["Γ errs by 1 where only 1 % of its data are further from what it predicts."]
    return "\n".join(lines) + "\n"


def _table(kind: Failure) -> list[str]:
    """The first and the last steps of the example, a line each."""
    lines = ["| step | node | outcome | controls | C says | Γ errs |", "|---|---|---|---|---|---|"]
    for i, act in enumerate(kind.way):
        if i < FIRST or i >= len(kind.way) - LAST:
            cells = act.node, act.outcome, _controls(act), _said(act)
            lines.append(f"| {i} | {' | '.join(cells)} |")
        elif i == FIRST:
            lines.append("| ... | | | | | |")
    return lines


def _controls(act: Act) -> str:
    """The controls of an action in short."""
    rows = [" ".join(f"{value:.3g}" for value in m.control.tolist()) for m in act.motions]
    return "; ".join(rows)


def _said(act: Act) -> str:
    """What C and Γ say of an action, in two columns."""
    errors = [motion.error for motion in act.motions if motion.error is not None]
    chance = "" if act.chance is None else f"{act.chance:.2f}"
    return f"{chance} | {f'{max(errors):.2g}' if errors else ''}"
