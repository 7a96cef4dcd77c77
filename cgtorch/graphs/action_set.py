"""The actions that a population may use, with their properties as tensors."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Generator, Tensor

from cgtorch.graphs.action import Action
from cgtorch.ground.errors import ActionError

AN_ACTION_SET = "an ActionSet, such as domain.actions()"


@dataclass(frozen=True)
class ActionSet:
    """A actions in a fixed order; a node's action is an index into it.

    ActionError without any action, for a duplicate name, or for an action without outcomes.
    Names and actions may be given as lists.

    Attributes:
        names: Unique names, as in graphs and files.
        actions: The torch modules.
        terminal: (A, O) bool, outcomes that end the computation; O is the largest number of
            outcomes.
        succeeds: (A, O) bool, terminal outcomes with which the skill succeeds.
        has_edge: (A, O) bool, outcomes that must lead to a node.
        num_parameters: (A,) long.
        standard: (A,) long, 1 if the parameters of new nodes are standard normal.
        message_size: Length of the longest message.
    """

    names: Sequence[str]
    actions: Sequence[Action]
    terminal: Tensor = field(init=False, repr=False, compare=False)
    succeeds: Tensor = field(init=False, repr=False, compare=False)
    has_edge: Tensor = field(init=False, repr=False, compare=False)
    num_parameters: Tensor = field(init=False, repr=False, compare=False)
    standard: Tensor = field(init=False, repr=False, compare=False)
    message_size: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the actions and lay out their tables."""
        vars(self).update(names=tuple(self.names), actions=tuple(self.actions))
        _check(self.names, self.actions)
        width = max(len(action.outcomes) for action in self.actions)
        terminal, succeeds, has_edge = torch.zeros(3, len(self), width, dtype=torch.bool)
        for i, action in enumerate(self.actions):
            for j, outcome in enumerate(action.outcomes):
                terminal[i, j] = outcome in action.terminal
                succeeds[i, j] = action.terminal.get(outcome, False)
                has_edge[i, j] = outcome not in action.terminal
        vars(self).update(
            terminal=terminal,
            succeeds=succeeds,
            has_edge=has_edge,
            num_parameters=torch.tensor([a.num_parameters for a in self.actions]),
            standard=torch.tensor([int(_is_standard(a)) for a in self.actions]),
            message_size=max(a.message_size for a in self.actions),
        )

    def __len__(self) -> int:
        """The number of actions."""
        return len(self.actions)

    @property
    def outcome_capacity(self) -> int:
        """O, the largest number of outcomes of an action."""
        return self.terminal.shape[1]

    @property
    def parameter_capacity(self) -> int:
        """K, the largest number of parameters of an action."""
        return int(self.num_parameters.max())

    def index(self, name: str) -> int:
        """The index of the action called `name`; ActionError if there is none."""
        if name not in self.names:
            raise ActionError(f"unknown action {name!r}; known are {', '.join(self.names)}")
        return self.names.index(name)

    def extended(self, names: Sequence[str], actions: Sequence[Action]) -> "ActionSet":
        """This set with more actions at its end; existing indices stay the same."""
        return ActionSet((*self.names, *names), (*self.actions, *actions))

    def initial_parameters(
        self, action: Tensor, generator: Generator, slots: int | None = None
    ) -> Tensor:
        """Parameters (..., K) of new nodes with the given actions (...), zero in unused entries.

        Numbers are drawn for every action in turn, so the state of the generator afterwards does
        not depend on the nodes. For actions (P, N), `slots` limits the result to the first slots
        (P, slots, K), which saves memory.
        """
        wanted = action[..., :slots]
        out = torch.zeros(*wanted.shape, self.parameter_capacity)
        for i, module in enumerate(self.actions):
            if k := module.num_parameters:
                drawn = module.initial_parameters(action.numel(), generator).detach()
                rows = drawn.view(*action.shape, k)[..., :slots, :].to(out)
                part = out[..., :k]
                torch.where((wanted == i)[..., None], rows, part, out=part)
                del drawn, rows  # before the next are drawn, which may be gigabytes
        return out

    def parameters_of(self, action: Tensor, generator: Generator) -> Tensor:
        """Parameters (..., K) of new nodes with the given actions (...), zero in unused entries.

        Numbers are drawn for these nodes only, and none for unused slots, whose action is negative.
        """
        out = torch.zeros(*action.shape, self.parameter_capacity)
        for i, module in enumerate(self.actions):
            here = action == i
            if module.num_parameters and (count := int(here.sum())):
                drawn = module.initial_parameters(count, generator).detach()
                out[..., : module.num_parameters][here] = drawn.to(out)
        return out


def _is_standard(action: Action) -> bool:
    """Whether an action uses the default `initial_parameters`."""
    return type(action).initial_parameters is Action.initial_parameters and (
        "initial_parameters" not in vars(action)
    )


def _check(names: Sequence[str], actions: Sequence[Action]) -> None:
    if not actions or len(names) != len(actions):
        raise ActionError(
            f"{len(names)} names for {len(actions)} actions; give one name for each of at least one"
        )
    if twice := {n for n, count in Counter(names).items() if count > 1}:
        raise ActionError(f"action name {sorted(twice)[0]!r} is used twice; names must be unique")
    for name, action in zip(names, actions, strict=True):
        if not isinstance(action, Action):
            raise ActionError(f"action {name!r} is a {type(action).__name__}; subclass Action")
        if not action.outcomes or len(set(action.outcomes)) != len(action.outcomes):
            raise ActionError(f"action {name!r} has outcomes {action.outcomes}; give unique names")
        if unknown := set(action.terminal) - set(action.outcomes):
            raise ActionError(
                f"action {name!r} ends on {sorted(unknown)[0]!r}, which is none of its outcomes "
                f"{action.outcomes}"
            )
