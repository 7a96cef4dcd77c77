"""Γ and C as an environment: the place where skills are evolved (section V)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.environment import Lanes, rows_where
from cgtorch.environment.dry_run import ROWS, expect, expect_pair, kind, returned, two_rows
from cgtorch.ground.errors import ModelError

Gamma: TypeAlias = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Percepts (n, D) and controls (n, U) to the next percepts (n, D) and how novel (n,) each is."""

Classifier: TypeAlias = Callable[[Tensor], Tensor]
"""Percepts (n, D) to the probability of success (n,)."""

Possible: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Percepts (n, D) and controls (n, U) to (n,) bool, whether the control can be carried out."""


@dataclass(frozen=True)
class CompiledModels:
    """Models as compiled rollouts know them.

    Attributes:
        name: what the names of their functions begin with, as in `tabletop_rollouts`.
        dtype: of their numbers.
        structure: what these functions get as `models` (native/engine/models.h).
        networks: kinds of networks of their own, which read percepts of one length only.
    """

    name: str
    dtype: torch.dtype
    structure: Any
    networks: tuple[str, ...] = ()


Compile: TypeAlias = Callable[["ModelEnvironment"], CompiledModels | None]
"""From models to what compiled rollouts know, or None where these have no such models."""

UNKNOWN = -1.0
LEAST_NOVEL = 0.75
"""How novel to Γ a motion may be in any case: half as far again beyond the data as their rim."""


def anything(percept: Tensor, control: Tensor) -> Tensor:
    """`Possible` where nothing is ever in the way."""
    return torch.ones(len(percept), dtype=torch.bool, device=percept.device)


class ModelEnvironment:
    """An `Environment` that consists of percepts only; nothing in it touches the world.

    Perceiving again changes nothing, since Γ predicts what would be perceived. A lane's state
    (n, 3) counts its motions, says whether it is lost, and holds C(p) once that has been asked for,
    `UNKNOWN` before. Lost is a lane once a motion was too novel to Γ: nobody knows where it is, so
    it neither moves nor succeeds any more.
    """

    def __init__(
        self,
        percepts: Tensor,
        gamma: Gamma,
        classifier: Classifier,
        possible: Possible = anything,
        control_size: int = 3,
        errors: Tensor | None = None,
        most_novel: float = LEAST_NOVEL,
        seeds: Tensor | None = None,
        compiled: Compile | None = None,
        chance: Tensor | None = None,
    ):
        """Set up the models; ModelError if one, tried on two percepts, breaks its interface.

        Args:
            percepts: (B, D), the first of B scenarios.
            gamma: the transition model Γ, which says how novel a motion is to it, in [0, 1].
            classifier: the success classifier C.
            possible: whether a control can be carried out; where it cannot, the percept stays.
            control_size: U.
            errors: (B, T, D) what to add to Γ's prediction at each motion of each scenario, so
                that a skill is judged under what Γ may have got wrong; used in turn.
            most_novel: where a motion is more novel, the lane is lost.
            seeds: (B,) long, of what actions draw in each scenario; 0 … B - 1 if not given.
            compiled: gives these models to compiled rollouts, if there is code for them.
            chance: (B,) what C says of the first percepts, which is asked for if not given. From
                the CPU it has the same last digits wherever the models are.
        """
        self.percepts, self.gamma, self.classifier = percepts, gamma, classifier
        self.possible, self.control_size, self.errors = possible, control_size, errors
        self.most_novel, self.compiled = most_novel, compiled
        _check(self, seeds)
        self.seeds = torch.arange(len(percepts)) if seeds is None else seeds
        self.seeds = self.seeds.to(percepts.device)
        self.first_state = percepts.new_zeros(len(percepts), 3)
        # Most lanes try to grasp where they start.
        self.first_state[:, 2] = classifier(percepts) if chance is None else chance

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.percepts)

    @property
    def percept_size(self) -> int:
        """D."""
        return self.percepts.shape[1]

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        return self.first_state[scenario], self.percepts[scenario]

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """The percepts that Γ predicts for controls (n, U); as they were where one is not possible.

        A control that is not finite, such as that of a lane without a message, never is.
        """
        moved = control.isfinite().all(1) & ~self.lost(lanes)
        rows = rows_where(moved)
        moved[rows] &= self.possible(lanes.percept[rows], control[rows])
        rows = rows_where(moved)
        predicted, novelty = self.gamma(lanes.percept[rows], control[rows])
        if self.errors is not None:
            turn = lanes.state[rows, 0].long() % self.errors.shape[1]
            predicted = predicted + self.errors[lanes.scenario[rows], turn]
        lost = (novelty > self.most_novel).to(lanes.state)
        after = torch.stack([lanes.state[rows, 0] + 1, lost, UNKNOWN * (1 - lost)], 1)
        return replace(
            lanes,
            percept=_with_rows(lanes.percept, rows, moved, predicted),
            state=_with_rows(lanes.state, rows, moved, after),
        ), moved

    @staticmethod
    def lost(lanes: Lanes) -> Tensor:
        """(n,) bool, the lanes about which the models know nothing any more."""
        return lanes.state[:, 1] > 0

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """C(p), the probability that the task succeeds from here; 0 for lanes that are lost."""
        unknown = lanes.state[:, 2] == UNKNOWN
        rows = rows_where(unknown)
        if len(rows):
            after = lanes.state.index_select(0, rows)
            after[:, 2] = self.classifier(lanes.percept.index_select(0, rows))
            lanes = replace(lanes, state=_with_rows(lanes.state, rows, unknown, after))
        return lanes, lanes.state[:, 2]


def _with_rows(values: Tensor, rows: Tensor, which: Tensor, new: Tensor) -> Tensor:
    """Values (n, ...) with new ones for those of `rows` (k,) for which `which` (n,) is true."""
    old, which = values.index_select(0, rows), which.index_select(0, rows)
    return values.index_copy(0, rows, torch.where(which[:, None], new, old))


def _check(models: ModelEnvironment, seeds: Tensor | None) -> None:
    """Try the models on two percepts; ModelError says what is wrong with what they return."""
    percepts, errors = models.percepts, models.errors
    if percepts.dim() != 2 or not percepts.is_floating_point() or not percepts.numel():
        raise ModelError(f"percepts are {kind(percepts)}; give floating numbers (B, D)")
    if errors is not None and not (
        errors.dim() == 3
        and errors.shape[::2] == percepts.shape
        and errors.shape[1]
        and errors.is_floating_point()
    ):
        raise ModelError(
            f"errors of Γ are {kind(errors)}; give (B, T, D) for percepts that are {kind(percepts)}"
        )
    if seeds is not None and (seeds.shape != percepts.shape[:1] or seeds.dtype != torch.long):
        raise ModelError(f"seeds are {kind(seeds)}; give (B,) long, B as for {kind(percepts)}")
    rows = percepts[two_rows(len(percepts), percepts.device)]
    control = rows.new_zeros(ROWS, models.control_size)
    found = returned(ModelError, "Γ", models.gamma, rows, control)
    after, novelty = expect_pair(ModelError, "Γ", "next percepts, novelty", found)
    expect(ModelError, "Γ", "next percepts", after, rows.shape, rows.dtype)
    expect(ModelError, "Γ", "novelty", novelty, (ROWS,), rows.dtype)
    chance = returned(ModelError, "C", models.classifier, rows)
    expect(ModelError, "C", "", chance, (ROWS,), rows.dtype)
    free = returned(ModelError, "possible", models.possible, rows, control)
    expect(ModelError, "possible", "", free, (ROWS,), torch.bool)
