"""A skill: one computational graph with the actions of its nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.graphs.action_set import ActionSet
from cgtorch.graphs.graphs import Graphs, compacted
from cgtorch.graphs.validity import check_graph
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Skill:
    """A named computational graph; GraphError if it is not valid.

    Attributes:
        name: Its name, also as a node of another skill.
        graph: One graph (P = 1), with its nodes in the first slots.
        actions: The action set of its nodes, which may contain earlier skills as `SubSkill`s.
        max_transitions: The number of transitions after which it fails.
    """

    name: str
    graph: Graphs
    actions: ActionSet
    max_transitions: int = 20

    def __post_init__(self) -> None:
        """Check the graph and move its nodes to the first slots."""
        check_graph(self.graph, self.actions)
        object.__setattr__(self, "graph", compacted(self.graph[:1]))

    @property
    def num_nodes(self) -> int:
        """Number of nodes at the top level."""
        return int(self.graph.num_nodes[0])

    @property
    def sub_skills(self) -> dict[str, "Skill"]:
        """The skills that are nodes of this one, by name."""
        used = set(self.graph.action[0].tolist())
        return {
            name: action.skill
            for i, (name, action) in enumerate(
                zip(self.actions.names, self.actions.actions, strict=True)
            )
            if isinstance(action, SubSkill) and i in used
        }

    @property
    def used_actions(self) -> set[str]:
        """The names of the actions of its nodes and of those of the skills in it."""
        here = {self.actions.names[i] for i in self.graph.action[0, : self.num_nodes].tolist()}
        return here.union(*(skill.used_actions for skill in self.sub_skills.values()))

    @cached_property
    def depth(self) -> int:
        """Levels of skills within skills, 1 if there are none."""
        return 1 + max((s.depth for s in self.sub_skills.values()), default=0)


class SubSkill(Action):
    """An earlier skill as a node (section IV-A); it does not change, and runs to its own end.

    Its success is terminal, like that of the action that succeeded in it. If it fails or runs out
    of its own transitions, the edge of "failure" is followed.
    """

    outcomes: tuple[str, ...] = ("success", "failure")
    terminal: Mapping[str, bool] = {"success": True}

    def __init__(self, skill: Skill):
        super().__init__()
        self.skill = skill
        self.message_size = skill.actions.message_size

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`; always an ActionError, as `rollout` runs the skill's own nodes."""
        raise ActionError(
            f"sub-skill {self.skill.name!r} cannot run as one step; run it with rollout()"
        )
