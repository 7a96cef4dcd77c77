"""Γ and C as an environment, in which skills are evolved (section V)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.ground.dry_run import ROWS, expect, expect_pair, kind, returned, two_rows
from cgtorch.ground.environment import Lanes, rows_where
from cgtorch.ground.errors import ModelError

Gamma: TypeAlias = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Maps percepts (n, D) and controls (n, U) to the next percepts (n, D) and novelties (n,)."""

Classifier: TypeAlias = Callable[[Tensor], Tensor]
"""Maps percepts (n, D) to probabilities of success (n,)."""

Possible: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps percepts (n, D) and controls (n, U) to (n,) bool, whether the control can be carried out."""


@dataclass(frozen=True)
class CompiledModels:
    """Models in the form of compiled rollouts."""

    name: str  # the prefix of their functions, such as in `tabletop_rollouts`
    dtype: torch.dtype  # of their numbers
    structure: Any  # the argument `models` of these functions (native/engine/models.h)
    networks: tuple[str, ...] = ()  # their own kinds, which read percepts of one length only


Compile: TypeAlias = Callable[["ModelEnvironment"], CompiledModels | None]
"""Maps models to their compiled form, or to None if there is none."""

UNKNOWN = -1.0
MOST_NOVEL = 0.75
"""The default limit of novelty, which is 0 at the data and tends to 1 away from them."""


def anything(percept: Tensor, control: Tensor) -> Tensor:
    """A `Possible` for environments where every control can be carried out."""
    return torch.ones(len(percept), dtype=torch.bool, device=percept.device)


class ModelEnvironment:
    """An `Environment` made of Γ and C, which contains percepts only and never touches the world.

    A lane's state (n, 3) holds the number of its motions, whether it is lost, and C(p), which is
    `UNKNOWN` until it is computed. A lane is lost after a motion that was too novel to Γ: it
    neither moves nor succeeds any more.
    """

    def __init__(
        self,
        percepts: Tensor,
        gamma: Gamma,
        classifier: Classifier,
        possible: Possible = anything,
        control_size: int = 3,
        errors: Tensor | None = None,
        most_novel: float = MOST_NOVEL,
        seeds: Tensor | None = None,
        compiled: Compile | None = None,
        chance: Tensor | None = None,
    ):
        """Set up the models; ModelError if one breaks its interface in a dry run on two percepts.

        Args:
            percepts: (B, D), the first percepts of B scenarios.
            gamma: The transition model Γ, which also returns the novelty of a motion, in [0, 1].
            classifier: The success classifier C.
            possible: Whether a control can be carried out; if not, the percept stays.
            control_size: U.
            errors: (B, T, D) errors that are added to Γ's predictions, by scenario and motion, so
                that a skill is evaluated under possible errors of Γ. After T motions they repeat.
            most_novel: A lane is lost after a motion that is more novel; with 1 none is ever lost.
            seeds: (B,) long, seeds of the random numbers that actions draw; 0 … B - 1 by default.
            compiled: Gives these models to compiled rollouts, if there is code for them.
            chance: (B,) C of the first percepts, computed by default.
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
        """Lanes with the percepts that Γ predicts for controls (n, U), and (n,) which are possible.

        Percepts stay where a control is not possible. One that is not finite never is.
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
        """(n,) bool, the lanes whose position is unknown to the models."""
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
    """Try the models on two percepts; ModelError says what is wrong with the results."""
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
