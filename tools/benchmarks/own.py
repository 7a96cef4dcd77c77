"""User-defined actions and worlds in torch, beside built-in ones, or ones written by hand."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from benchmarks.measure import (
    WALL,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    cores,
    in_turns,
    run_threads,
)
from benchmarks.workload import GENERATIONS, Workload, first_population, later_population, workload
from cgtorch import World
from cgtorch.graphs import Action, ActionSet, ContinuousNN, Graphs, Step
from cgtorch.ground.environment import Environment, Lanes, ScenarioBatch
from cgtorch.simulation import Rollouts, rollout

SIZES = (1000, 10_000)
SHARE = 6  # one of so many nodes waits
STEPS = 100  # of an episode in the world
SEEN, HIDDEN, SAID = 7, 3, 3
CLOSE = 1e-3  # of last percepts, after a hundred steps in float32


class Wait(Action):
    """An action of a user's own that does nothing."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        return lanes, torch.zeros(len(lanes), dtype=torch.long)


def own_action_unused(effort: Effort) -> Line:
    """An own action in the set that no graph uses."""
    return _with_wait(
        "own_action_unused", "rollouts, with an own action in the set that no graph uses", 1.05,
        lambda graphs, actions: graphs, effort,
    )  # fmt: skip


def own_action(effort: Effort) -> Line:
    """An own action in a sixth of all nodes."""
    return _with_wait(
        "own_action", f"rollouts, with an own action in one of {SHARE} nodes", 2.0,
        waiting_graphs, effort,
    )  # fmt: skip


def waiting_graphs(graphs: Graphs, actions: ActionSet) -> Graphs:
    """The same graphs in which every sixth node waits, and goes on as it did first."""
    p, n = graphs.action.shape
    slot = torch.arange(p * n).view(p, n) % SHARE == 0
    chosen = slot & (graphs.action >= 0) & (graphs.edges[..., 0] >= 0)
    edges = graphs.edges.clone()
    edges[..., 1:][chosen] = -1
    return replace(graphs, action=graphs.action.masked_fill(chosen, len(actions) - 1), edges=edges)


def _with_wait(
    name: str,
    compared: str,
    target: float,
    changed: Callable[[Graphs, ActionSet], Graphs],
    effort: Effort,
) -> Line:
    work = workload()
    actions = work.actions.extended(["Wait"], [Wait()])
    parts = []
    with run_threads(cores()):
        for size in SIZES:
            for label, population in (
                ("first population", first_population(size, work.actions)),
                (f"after {GENERATIONS} generations", later_population(size)),
            ):
                pair = population.graphs, changed(population.graphs, actions)
                parts.append(_wait_case(work, actions, *pair, f"{label}, {size}", effort))
    whole = f"{compared} / of the same graphs without it, in the same models"
    return Line(name, whole, "x the time", target, "wall", cores(), tuple(parts), at_most=True)


def _wait_case(
    work: Workload, actions: ActionSet, plain: Graphs, waiting: Graphs, label: str, effort: Effort
) -> Comparison:
    ours = partial(rollout, waiting, actions, work.environment)
    other = partial(rollout, plain, work.actions, work.environment)
    runs, others = ours(), other()
    if waiting is plain and not torch.equal(runs.percept, others.percept):
        raise DisagreementError("an action that is not used changes rollouts; nothing was timed")
    times = in_turns([ours, other], effort.repeats, WALL, calls=[5, 5])
    return Comparison(
        label=f"{label} x {work.environment.num_scenarios}",
        ours=times[0],
        other=times[1],
        ratio=times[0].median / times[1].median,
        difference=0.0 if waiting is plain else None,
        sizes={"executed": runs.executed, "executed of the other": others.executed},
        note=f"{runs.executed / times[0].median:.3g} / {others.executed / times[1].median:.3g} "
        "executed transitions/s",
    )


@dataclass(frozen=True)
class Points(ScenarioBatch):
    """Where points begin (B, 7)."""

    place: Tensor


class Drift(World):
    """A point that goes where it is told, and a little further: about the simplest world."""

    control_size = SAID

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        place: Tensor = self.scenarios.place[scenario]
        return place

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`."""
        return drifted(state, control)

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`."""
        return state[:, 0].abs() < 1e-3


def drifted(state: Tensor, control: Tensor) -> Tensor:
    """States (n, 7) after controls (n, 3)."""
    moved = state[:, :SAID] + 0.1 * control.clamp(-1, 1)
    return torch.cat([moved, 0.99 * state[:, SAID:] + 0.01], 1)


class Drive(Action):
    """A network that drives by itself: the whole node is user code."""

    outcomes: tuple[str, ...] = ("success", "failure")
    num_parameters = HIDDEN * (SEEN + 1) + SAID * (HIDDEN + 1)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes, done = environment.step(lanes, by_hand(lanes.percept, parameters))
        return lanes, (~done).long()


def by_hand(seen: Tensor, weights: Tensor) -> Tensor:
    """Outputs (n, 3) of networks (n, 36) for percepts (n, 7), as usually written in torch."""
    first, b1, second, b2 = weights.split([HIDDEN * SEEN, HIDDEN, SAID * HIDDEN, SAID], 1)
    w1, w2 = first.unflatten(1, (HIDDEN, SEEN)), second.unflatten(1, (SAID, HIDDEN))
    hidden = torch.baddbmm(b1[..., None], w1, seen[..., None]).sigmoid()
    return torch.baddbmm(b2[..., None], w2, hidden)[..., 0]


def loop_by_hand(place: Tensor, weights: Tensor) -> Tensor:
    """Episodes of all networks at once, as usually written by hand."""
    state = place
    for _ in range(STEPS):
        state = drifted(state, by_hand(state, weights))
    return state


def own_world(effort: Effort) -> Line:
    """A world written in torch, which the library does not know."""
    sets = {
        "own action": (ActionSet(("Drive",), (Drive(),)), (0,), 1),
        "network → step": (
            ActionSet(("Aim", "Step"), (ContinuousNN(SEEN, HIDDEN, SAID), Step(SAID))),
            (0, 1),
            2,
        ),
    }
    with run_threads(1):
        parts = [
            _world_case(actions, nodes, each, size, f"{label}, {size} x 1", effort)
            for label, (actions, nodes, each) in sets.items()
            for size in SIZES
        ]
    compared = (
        f"individual-steps per second, {STEPS} steps of 7-3-3 networks in a world in torch / a "
        "loop by hand over the same networks and world, one thread"
    )
    return Line("own_world", compared, "x as fast", 0.6, "wall", 1, tuple(parts))


def ring(actions: ActionSet, nodes: tuple[int, ...], weights: Tensor) -> Graphs:
    """Graphs (P,) of these actions in a ring, the first of which has the weights (P, K)."""
    p, n = len(weights), len(nodes)
    parameters = torch.zeros(p, n, actions.parameter_capacity)
    parameters[:, 0] = weights
    successors = (torch.arange(n) + 1) % n
    has = actions.has_edge[torch.tensor(nodes)]
    edges = torch.where(has, successors[:, None], -1).expand(p, -1, -1).contiguous()
    start = torch.zeros(p, dtype=torch.long)
    return Graphs(torch.tensor(nodes).expand(p, -1).contiguous(), edges, parameters, start)


def _world_case(
    actions: ActionSet, nodes: tuple[int, ...], each: int, size: int, label: str, effort: Effort
) -> Comparison:
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(size, Drive.num_parameters, generator=generator)
    place = torch.randn(1, SEEN, generator=generator)
    graphs, steps = ring(actions, nodes, weights), STEPS * each
    ours: Callable[[], Rollouts] = partial(
        rollout, graphs, actions, Drift(Points(place)), max_transitions=steps, max_steps=steps
    )
    other = partial(loop_by_hand, place.expand(size, -1), weights)
    runs = ours()
    gap = float((runs.percept[:, 0] - other()).abs().max())
    if not gap <= CLOSE or runs.executed != steps * size:
        raise DisagreementError(f"worlds differ by {gap}; nothing was timed")
    times = in_turns([ours, other], effort.repeats, WALL, calls=[3, 3])
    rates = [size * STEPS / t.median for t in times]
    return Comparison(
        label=label,
        ours=times[0],
        other=times[1],
        ratio=rates[0] / rates[1],
        difference=gap,
        sizes={"individuals": size, "steps": STEPS, "steps_per_second": rates[0]},
        note=f"{rates[0]:.3g} / {rates[1]:.3g} individual-steps/s",
    )
