"""A skill: one computational graph with the actions of its nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.graphs.action_set import ActionSet
from cgtorch.graphs.graphs import NO_NODE, Graphs, check_graph, compacted
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError
from cgtorch.ground.given import of_kind, whole_number

A_SKILL = "a Skill, such as load_skill returns"
MOST_TRANSITIONS = 2**31


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Skill:
    """A named computational graph; GraphError if it is not valid, SettingsError for what is none.

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
        of_kind(self.name, str, "the name of a skill", "a text")
        limit = whole_number(self.max_transitions, "max_transitions", 1, MOST_TRANSITIONS)
        object.__setattr__(self, "max_transitions", limit)
        check_graph(self.graph, self.actions)
        object.__setattr__(self, "graph", compacted(self.graph[:1]))

    @property
    def num_nodes(self) -> int:
        """Number of nodes at the top level."""
        return int(self.graph.num_nodes[0])

    @cached_property
    def node_actions(self) -> dict[str, Action]:
        """The actions and skills of its nodes by name, in the order of the action set."""
        used = sorted(set(self.graph.action[0].tolist()) - {NO_NODE})
        return {self.actions.names[i]: self.actions.actions[i] for i in used}

    @property
    def sub_skills(self) -> dict[str, "Skill"]:
        """The skills that are nodes of this one, by name."""
        found = self.node_actions.items()
        return {name: action.skill for name, action in found if isinstance(action, SubSkill)}

    @cached_property
    def levels(self) -> tuple["Skill", ...]:
        """The skill and all skills in it, each once, level by level from the outermost."""
        found = [self]
        for skill in found:  # grows on the way
            inner = dict.fromkeys(skill.sub_skills.values())
            found.extend(each for each in inner if each not in found)
        return tuple(found)

    @property
    def primitives(self) -> tuple[tuple[str, Action], ...]:
        """The actions of all nodes at all levels that are no skills, each once, with names."""
        found: dict[Action, str] = {}
        for skill in self.levels:
            for name, action in skill.node_actions.items():
                found.setdefault(action, name)
        return tuple((name, a) for a, name in found.items() if not isinstance(a, SubSkill))

    @property
    def used_actions(self) -> set[str]:
        """The names of the actions of its nodes and of those of the skills in it."""
        return {name for skill in self.levels for name in skill.node_actions}

    @cached_property
    def depth(self) -> int:
        """Levels of skills within skills, 1 if there are none."""
        return 1 + max((s.depth for s in self.sub_skills.values()), default=0)


def a_skill(value: object) -> Skill:
    """A skill that is given; SettingsError for anything else."""
    return of_kind(value, Skill, "skill", A_SKILL)


class SubSkill(Action):
    """An earlier skill as a node (section IV-A), which runs to its own end.

    Its success is terminal. If it fails or runs out of its own transitions, the edge of "failure"
    is followed.
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
