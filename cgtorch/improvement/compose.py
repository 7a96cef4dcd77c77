"""Composition: earlier skills as nodes under branching nodes (section IV-A)."""

import torch
from torch import Tensor

from cgtorch.graphs import NO_NODE, ActionSet, BranchingNN, Graphs, Skill, SubSkill, same_behaviour
from cgtorch.ground.errors import ActionError


def branching_action(actions: ActionSet) -> tuple[int, BranchingNN]:
    """The index and module of the set's branching network; ActionError if there is none."""
    for i, action in enumerate(actions.actions):
        if isinstance(action, BranchingNN):
            return i, action
    raise ActionError(f"no BranchingNN among {', '.join(actions.names)}; composition needs one")


def compose(
    name: str, members: list[Skill], branches: Tensor, actions: ActionSet, max_transitions: int
) -> Skill:
    """A skill that branches to one of its members, which are frozen sub-skills.

    The branching nodes, with parameters (M - 1, K), are visited in turn. A member that fails is
    followed by the next one, and the last by the first, so a wrong branch can be corrected. Members
    that behave the same share one node; members that differ need different names.
    """
    kind, branch = branching_action(actions)
    m = len(members)
    place = [next(j for j in range(m) if same_behaviour(members[j], s)) for s in members]
    distinct = sorted(set(place))
    if len(distinct) == 1:
        return Skill(name, members[0].graph, members[0].actions, max_transitions)
    different = [members[j] for j in distinct]
    both = actions.extended([s.name for s in different], [SubSkill(s) for s in different])
    first_member = m - 1
    n = first_member + len(distinct)
    action = torch.cat([torch.full((m - 1,), kind), len(actions) + torch.arange(len(distinct))])
    edges = torch.full((1, n, both.outcome_capacity), NO_NODE)
    parameters = torch.zeros(1, n, both.parameter_capacity)
    node = [first_member + distinct.index(j) for j in place]
    for i in range(m - 1):
        edges[0, i, 0] = node[i]
        edges[0, i, 1] = i + 1 if i < m - 2 else node[-1]
        parameters[0, i, : branch.num_parameters] = branches[i]
    edges[0, first_member:, 1] = torch.arange(1, len(distinct) + 1) % len(distinct) + first_member
    graph = Graphs(action[None], edges, parameters, torch.zeros(1, dtype=torch.long))
    return Skill(name, graph, both, max_transitions)


def specialists_of(skill: Skill) -> tuple[Skill, ...]:
    """The skills at any level of a composed skill that contain no other skills; () if none do."""
    found: dict[str, Skill] = {}
    for name, sub in skill.sub_skills.items():
        found.update({s.name: s for s in specialists_of(sub)} or {name: sub})
    return tuple(found.values())


def fewest_members(solves: Tensor, keep: Tensor, most: int | None = None) -> list[int]:
    """Few members that together solve all that any of them solves, as ascending indices.

    They are chosen greedily. Members that add nothing are left out, except those marked in `keep`
    (M,) bool. `solves` is (B, M) bool. If more than `most` members would be needed, the result
    solves as much as possible with `most`.
    """
    chosen = keep.nonzero()[:, 0].tolist()
    covered = solves[:, chosen].any(1)
    while True:
        gain = (solves & ~covered[:, None]).sum(0)
        best = int(gain.argmax()) if len(gain) else 0
        if not len(gain) or gain[best] == 0 or len(chosen) == most:
            return sorted(chosen)
        chosen.append(best)
        covered |= solves[:, best]
