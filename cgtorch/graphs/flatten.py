"""Flattening: a skill with all skills in it as one graph of primitive actions."""

import torch

from cgtorch.actions import Action, ActionSet
from cgtorch.errors import GraphError
from cgtorch.graphs.graphs import NO_NODE, Graphs, resized
from cgtorch.graphs.skill import Skill, SubSkill
from cgtorch.graphs.validity import pruned


def flattened(skill: Skill) -> Skill:
    """The same skill without skills in it.

    Every node that is a sub-skill gives way to the sub-skill's own graph: what led to the node
    leads to its start. Message and memory belong to the lane, so nodes find them as before. A
    sub-skill hands back in two cases only. Where an action ends it without success, one graph
    cannot say the same, because a terminal outcome has no edge. Where it runs out of its own
    transitions, one graph has no count to tell that by: it stays in the sub-skill's graph.

    So a run is the same, in its actions, outcomes, percepts and their number, up to where any
    skill, or the whole, runs out of its transitions for the first time; in particular a run that
    ends before is the same altogether. A run that would go on from there may succeed with one and
    not with the other. What sub-skills have never handed back from is the same everywhere.

    Returns:
        A skill of the same name, over the primitive actions of all levels, those of the outermost
        first. It may make as many transitions as a run can before any skill runs out.

    Raises:
        GraphError: an action ends a sub-skill without success, or a name stands for different
            actions at different levels.
    """
    parts = _innermost_first(skill, {})
    actions = _primitives(list(parts.values()))
    kinds = {id(action): i for i, action in enumerate(actions.actions)}
    tables: list[Graphs] = []
    entry: dict[int, int] = {}  # first row of each skill, by identity
    rows = 0
    for part in parts.values():
        if part is not skill:
            _check_ends(part)
        table, entry[id(part)] = _table(part, rows, kinds, entry)
        n = part.graph.capacity
        tables.append(resized(table, n, actions.outcome_capacity, actions.parameter_capacity))
        rows += n
    graph = Graphs(
        torch.cat([t.action for t in tables], 1),
        torch.cat([t.edges for t in tables], 1),
        torch.cat([t.parameters for t in tables], 1),
        skill.graph.start.new_tensor([entry[id(skill)]]),
    )
    return Skill(skill.name, pruned(graph), actions, _transitions(skill))


def _innermost_first(skill: Skill, found: dict[int, Skill]) -> dict[int, Skill]:
    """The skill and all skills in it by identity, each once and after those in it."""
    for sub in skill.sub_skills.values():
        if id(sub) not in found:
            _innermost_first(sub, found)
    found[id(skill)] = skill
    return found


def _primitives(parts: list[Skill]) -> ActionSet:
    """The actions of all levels that are no skills."""
    found: dict[str, Action] = {}
    for part in reversed(parts):
        for name, action in zip(part.actions.names, part.actions.actions, strict=True):
            if isinstance(action, SubSkill):
                continue
            if found.setdefault(name, action) is not action:
                raise GraphError(
                    f"skill {part.name!r} has another action {name!r} than the skill that it is "
                    "in; make both with the same actions"
                )
    return ActionSet(tuple(found), tuple(found.values()))


def _check_ends(part: Skill) -> None:
    """Refuse a sub-skill that an action can end without success."""
    for i in part.graph.action[0].unique().tolist():
        terminal = part.actions.actions[i].terminal if i != NO_NODE else {}
        for outcome, success in terminal.items():
            if not success:
                raise GraphError(
                    f"{part.actions.names[i]} ends sub-skill {part.name!r} with outcome "
                    f"{outcome!r} and the skill that it is in goes on, which one graph cannot say; "
                    "leave it nested"
                )


def _table(
    part: Skill, rows: int, kinds: dict[int, int], entry: dict[int, int]
) -> tuple[Graphs, int]:
    """The nodes of one skill from row `rows` on, without its sub-skills, and its first row."""
    graph, modules = part.graph, part.actions.actions
    kind = graph.action.clone()
    row = rows + torch.arange(graph.capacity, device=kind.device)
    for i, module in enumerate(modules):
        here = graph.action[0] == i
        if isinstance(module, SubSkill):
            kind[0, here] = NO_NODE
            if here.any():
                row[here] = entry[id(module.skill)]
        else:
            kind[0, here] = kinds[id(module)]
    gone = (kind == NO_NODE)[..., None]
    edges = torch.where(graph.edges == NO_NODE, NO_NODE, row[graph.edges.clamp_min(0)])
    parameters = graph.parameters.masked_fill(gone, 0.0)
    table = Graphs(kind, edges.masked_fill(gone, NO_NODE), parameters, graph.start)
    return table, int(row[graph.start])


def _transitions(skill: Skill) -> int:
    """The most actions of a run in which no skill runs out of its own transitions.

    Such a run enters one sub-skill on each level at most, since none hands back.
    """
    inner = max((_transitions(s) for s in skill.sub_skills.values()), default=1)
    return skill.max_transitions - 1 + inner
