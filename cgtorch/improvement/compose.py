"""Composition: skills as nodes under branching nodes (section IV-A), and choices of few of many."""

import torch
from torch import Generator, Tensor

from cgtorch.graphs import NO_NODE, ActionSet, BranchingNN, Graphs, Skill, SubSkill, same_behaviour
from cgtorch.ground.errors import ActionError


def branching_action(actions: ActionSet) -> tuple[int, BranchingNN]:
    """The index and module of the set's branching network; ActionError if there is none."""
    for i, action in enumerate(actions.actions):
        if isinstance(action, BranchingNN):
            return i, action
    raise ActionError(f"no BranchingNN among {', '.join(actions.names)}; composition needs one")


def compose(
    name: str,
    members: list[Skill],
    branches: Tensor,
    actions: ActionSet,
    max_transitions: int,
    *,
    corrected: bool = True,
) -> Skill:
    """A skill that branches to one of its members, which are frozen sub-skills.

    The branching nodes, with parameters (M - 1, K), are visited in turn. If wrong branches are
    `corrected`, a member that fails is followed by the next one, and the last by the first.
    Otherwise it is followed by itself. Members that behave the same share one node; members that
    differ need different names.
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
    others = torch.arange(len(distinct)) + corrected
    edges[0, first_member:, 1] = others % len(distinct) + first_member
    graph = Graphs(action[None], edges, parameters, torch.zeros(1, dtype=torch.long))
    return Skill(name, graph, both, max(max_transitions, m + 1))


def branches_of(skill: Skill) -> tuple[list[str], Tensor] | None:
    """The names of the members to which a composed skill branches, and (M - 1, K) parameters.

    None if it is not composed.
    """
    if not skill.sub_skills:
        return None
    kind, branch = branching_action(skill.actions)
    graph = skill.graph
    count = int((graph.action[0] == kind).sum())
    first, last = graph.edges[0, :count, 0], graph.edges[0, count - 1, 1:2]
    nodes = graph.action[0][torch.cat([first, last])].tolist()
    return [skill.actions.names[node] for node in nodes], graph.parameters[
        0, :count, : branch.num_parameters
    ]


def specialists_of(skill: Skill) -> tuple[Skill, ...]:
    """The skills at any level of a composed skill that contain no other skills; () if none do."""
    found: dict[str, Skill] = {}
    for name, sub in skill.sub_skills.items():
        found.update({s.name: s for s in specialists_of(sub)} or {name: sub})
    return tuple(found.values())


def fewest_members(solves: Tensor, most: int) -> list[int]:
    """Up to `most` members that together solve what all of them solve, as ascending indices.

    `solves` is (B, M) bool. The member that adds most is chosen next, and none that adds nothing.
    """
    chosen, covered = list[int](), torch.zeros(len(solves), dtype=torch.bool)
    while solves.shape[1] and len(chosen) < most:
        gain = (solves & ~covered[:, None]).sum(0)
        best = int(gain.argmax())
        if gain[best] == 0:
            break
        chosen.append(best)
        covered |= solves[:, best]
    return sorted(chosen)


def broad_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of missed scenarios, drawn at random; for the arguments see `local_group`."""
    rows = missed.nonzero()[:, 0]
    return rows[torch.randperm(len(rows), generator=generator)[:size]]


def local_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices (n,), at most `size`, of a random `missed` (B,) scenario and its nearest missed ones.

    Distances are those of first percepts (B, D).
    """
    rows = missed.nonzero()[:, 0]
    seed = rows[torch.randint(len(rows), (1,), generator=generator)]
    distance = torch.cdist(percepts[rows], percepts[seed])[:, 0]
    return rows[distance.argsort(stable=True)[:size]]


def cover(percepts: Tensor, size: int) -> tuple[Tensor, float]:
    """(n,) long, ascending, a coreset of first percepts (B, D), and the largest distance to it.

    The first scenario is chosen, then repeatedly the one farthest from those chosen, up to `size`
    (Gonzalez 1985). The distance is at most twice that of the best choice of as many. Of equal
    percepts, only one is chosen.
    """
    if len(percepts) <= size:
        return torch.arange(len(percepts)), 0.0
    distance = torch.full((len(percepts),), torch.inf)
    rows = [0]
    while True:
        distance = torch.minimum(distance, (percepts - percepts[rows[-1]]).norm(dim=1))
        if len(rows) == size or not distance.any():
            return torch.tensor(rows).sort()[0], float(distance.max())
        rows.append(int(distance.argmax()))
