"""What a skill does on a scenario, act by act, and what Γ and C say of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.domains.knowledge import Knowledge
from cgtorch.graphs import Skill
from cgtorch.ground.environment import Environment
from cgtorch.ground.fields import Field
from cgtorch.simulation import Recording, Step, traced
from cgtorch.simulation.tracing import name_of

USUAL = 0.99  # share of the data on which Γ errs less than where prediction and world part
HELD_OUT = 50  # transitions that are enough to measure that on held-out ones
ROWS = 1000  # of the data, on which it is measured otherwise
LEAST = 1e-6  # of the range of a number, below which no error of Γ counts


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Motion:
    """A control (U,), the percept (D,) that followed, and what Γ says; None without models.

    Attributes:
        control: The control.
        became: The percept that followed.
        predicted: (D,) the percept that Γ says would follow.
        error: How wrong that is, in units of what is exceeded by 1 % of Γ's data.
        errors: (D,) the same for each number of the percept.
        novelty: How far the motion is from Γ's data: 1/2 at their edge, 1 far away.
    """

    control: Tensor
    became: Tensor
    predicted: Tensor | None = None
    error: float | None = None
    errors: Tensor | None = None
    novelty: float | None = None


@dataclass(frozen=True, eq=False)
class Act:
    """An action of a node: its outcome, the percept (D,) afterwards, and its motions.

    `node` names the nodes that contain it, outermost first, with their slots. `chance` is what C
    says of the percept; None without models. `refused` (U,) is a control that was asked for, and
    that the world has not carried out.
    """

    node: str
    outcome: str
    percept: Tensor
    motions: tuple[Motion, ...]
    chance: float | None = None
    refused: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Way:
    """The acts of a skill on a scenario, from the first percept (D,) to the end."""

    first: Tensor
    acts: tuple[Act, ...]
    end: str

    @property
    def parts(self) -> int | None:
        """The number of the first act in which the world did something that Γ had not predicted.

        None if there is none, or without models.
        """
        wrong = (
            i for i, act in enumerate(self.acts) if any((m.error or 0) > 1 for m in act.motions)
        )
        return next(wrong, None)

    @property
    def still(self) -> int:
        """The number of the first act from which on no control is carried out."""
        moving = [i for i, act in enumerate(self.acts) if act.motions]
        return moving[-1] + 1 if moving else 0


class Judge:
    """What Γ and C say, if they are known."""

    def __init__(self, knowledge: Knowledge | None, percept: Sequence[Field]) -> None:
        """What the models of `knowledge` say of percepts with these fields; nothing without any."""
        self._known = knowledge
        self._turns = torch.tensor([field.kind == "angle" for field in percept])
        if knowledge is not None:
            held_out = len(knowledge.aside.percept) >= HELD_OUT
            data, gamma = knowledge.aside if held_out else knowledge.dataset, knowledge.gamma
            p, u, q = (x[:ROWS] for x in (data.percept, data.control, data.next_percept))
            with torch.no_grad():
                predicted = gamma(p, u)
                self._usual = max(1e-9, float(gamma.errors(predicted, q).quantile(USUAL)))
                each = self._apart(predicted, q).quantile(USUAL, 0)
            least = LEAST * (q.amax(0) - q.amin(0)) + 1e-9
            self._each = torch.maximum(each, least)

    def of_motion(self, before: Tensor, control: Tensor, became: Tensor) -> Motion:
        """A motion, with what Γ says."""
        if self._known is None:
            return Motion(control, became)
        gamma = self._known.gamma
        with torch.no_grad():
            predicted, novelty = gamma.predict_with_novelty(before[None], control[None])
            error = float(gamma.errors(predicted, became[None])) / self._usual
        errors = self._apart(predicted[0], became) / self._each
        return Motion(control, became, predicted[0], error, errors, float(novelty))

    def chances(self, percepts: Tensor) -> list[float | None]:
        """C(p) of percepts (n, D)."""
        if self._known is None:
            return [None] * len(percepts)
        with torch.no_grad():
            found: list[float | None] = self._known.classifier(percepts).tolist()
        return found

    def _apart(self, one: Tensor, other: Tensor) -> Tensor:
        """(..., D) how far percepts are apart, the shorter way round for angles."""
        apart = (one - other).abs()
        if len(self._turns) != apart.shape[-1]:
            return apart
        return torch.where(self._turns, torch.minimum(apart, 2 * torch.pi - apart).abs(), apart)


def way_of(skill: Skill, world: Environment, judge: Judge) -> Way:
    """What a skill does in a world of one scenario."""
    place = Recording(world)
    with torch.no_grad():
        run = traced(skill, place)
    motions = [
        (int(key), judge.of_motion(p, u, q))
        for keys, *columns in place.transitions
        for key, p, u, q in zip(keys, *columns, strict=True)
    ]
    percepts = torch.cat([lanes.percept for lanes in run.lanes])
    chances = judge.chances(percepts[1:])
    acts = []
    for number, (step, lanes) in enumerate(zip(run.steps, run.lanes, strict=False)):
        own = tuple(motion for key, motion in motions if key == number)
        asked = step.action.request == "control" and not own and bool(lanes.has_message)
        refused = lanes.message[0, : world.control_size] if asked else None
        about = node_of(step), step.outcome, percepts[number + 1], own, chances[number], refused
        acts.append(Act(*about))
    return Way(percepts[0], tuple(acts), run.end)


def node_of(step: Step) -> str:
    """The nodes that contain a step, outermost first, with their slots."""
    return " > ".join(f"{name_of(skill, slot)}_{slot}" for skill, slot in step.places)
