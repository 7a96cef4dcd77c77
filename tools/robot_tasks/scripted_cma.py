"""CMA-ES on the parameters of a script of primitives, which a person has written for the task.

The CMA-ES is `cgtorch.evolution.cma`, with its usual number of samples. It begins at zero, with the
deviations that parameters of new nodes have. The script begins again after its last primitive.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from cgtorch.evolution import cma
from cgtorch.graphs import NO_NODE, ActionSet, Graphs
from cgtorch.simulation import rollout
from robot_tasks.problem import Found, Problem, deviation_of, grade
from robot_tasks.scripts import script_of

GIVEN = "a script of primitives, written by hand for the task, and the grade of what failed"
FEW = 4  # starts of the group on which a generation is tried, other ones each time


def search(problem: Problem) -> Found:
    """Update the distribution until a sample that solves all of its few starts is good enough."""
    actions, generator = problem.domain.actions(), problem.generator
    steps = script_of(problem.task)
    deviation = deviations(actions, steps)
    now = cma.initial_distribution(torch.zeros_like(deviation), deviation)
    count, best, longest, highest = cma.usual_count(len(deviation)), None, -1, -1.0
    while not problem.over:
        samples = cma.sampled(now, count, generator)
        graphs = chains(actions, steps, samples)
        few = problem.group[torch.randperm(len(problem.group), generator=generator)[:FEW]]
        runs = rollout(graphs, actions, problem.domain.world(few), max_transitions=problem.most)
        fitness = grade(runs.state).mean(1)
        now, first = cma.updated(now, samples, fitness), int(fitness.argmax())
        graph, reached = graphs[first : first + 1], float(fitness[first])
        row = problem.in_a_row(problem.player(graph)) if reached == 1 else 0
        if (row, reached) > (longest, highest):
            best, longest, highest = graph, row, reached
        if row == problem.wanted:
            break
    play = None if best is None else problem.player(best)
    return problem.found(play, longest == problem.wanted)


def deviations(actions: ActionSet, steps: Sequence[str]) -> Tensor:
    """(n,) the standard deviations of the parameters of new nodes, one after the other."""
    return torch.cat([deviation_of(actions.actions[actions.index(name)]) for name in steps])


def chains(actions: ActionSet, steps: Sequence[str], parameters: Tensor) -> Graphs:
    """P graphs that execute the steps in a circle, with parameters (P, n), one after the other."""
    p, n = len(parameters), len(steps)
    action = torch.tensor([actions.index(name) for name in steps])
    after = ((torch.arange(n) + 1) % n)[:, None]
    edges = torch.where(actions.has_edge[action], after, NO_NODE)
    wide, begin = torch.zeros(p, n, actions.parameter_capacity), 0
    for i, size in enumerate(actions.num_parameters[action].tolist()):
        wide[:, i, :size] = parameters[:, begin : begin + size]
        begin += size
    start = torch.zeros(p, dtype=torch.long)
    return Graphs(action.expand(p, n).clone(), edges.expand(p, *edges.shape).clone(), wide, start)
