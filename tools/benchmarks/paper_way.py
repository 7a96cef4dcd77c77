"""Rollouts as in the paper: one individual, one scenario, one row at a time.

It is a state machine in plain Python that calls scikit-learn's SVR and SVC for one row where a
state needs them. All else is arithmetic on Python floats, which are faster than arrays for single
rows.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from benchmarks.plain_models import Array, PlainModels, sklearn_svc, sklearn_svr
from cgtorch.graphs import NO_NODE, ActionSet, Graphs
from cgtorch.tabletop.world.clear_motion import MAX_TRANSLATION, TURN_STEP

Row: TypeAlias = list[float]
TURNS = math.ceil(math.pi / TURN_STEP)
HIDDEN = 3


@dataclass(frozen=True)
class State:
    """A node: the name of its action, its parameters, and where each outcome leads, None to end."""

    action: str
    parameters: Row
    heads: tuple[int | None, ...]


@dataclass(frozen=True)
class StateMachine:
    """One individual: its nodes, and the first of them."""

    states: dict[int, State]
    start: int


def state_machines(graphs: Graphs, actions: ActionSet) -> list[StateMachine]:
    """The individuals as state machines."""
    counts = actions.num_parameters.tolist()
    outcomes = [len(a.outcomes) for a in actions.actions]
    rows = (x.tolist() for x in (graphs.action, graphs.edges, graphs.parameters, graphs.start))
    return [
        StateMachine(
            {
                i: State(
                    actions.names[a],
                    parameters[i][: counts[a]],
                    tuple(None if h == NO_NODE else h for h in edges[i][: outcomes[a]]),
                )
                for i, a in enumerate(action)
                if a != NO_NODE
            },
            start,
        )
        for action, edges, parameters, start in zip(*rows, strict=True)
    ]


class Simulation:
    """Γ and C of one row at a time."""

    def __init__(self, models: PlainModels):
        self.models = models
        self.svr: Any = sklearn_svr(models.transition)
        self.svc: Any = sklearn_svc(models.success)
        self.mean, self.scale = models.transition.mean.tolist(), models.transition.scale.tolist()
        self.seen_mean = models.success.mean.tolist()
        self.seen_scale = models.success.scale.tolist()
        self.sides, self.most = models.sides.tolist(), models.most.tolist()
        self.body: list[Row] = models.body.tolist()
        self.radius = max(math.hypot(x, y) for x, y in self.body)
        self.percepts, self.errors = models.percepts.tolist(), models.errors.tolist()

    def run(
        self, machine: StateMachine, scenario: int, max_transitions: int
    ) -> tuple[bool, Row, int]:
        """Whether a state machine succeeds, its last percept, and the transitions it took."""
        percept, message, motions, lost = self.percepts[scenario], None, 0, False
        node = machine.start
        for step in range(1, max_transitions + 1):
            state = machine.states[node]
            outcome = 0
            match state.action:
                case "MoveBase":
                    if message is not None and not lost and self.possible(percept, message):
                        errors = self.errors[scenario]
                        error = errors[motions % len(errors)]
                        percept, novelty = self.gamma(percept, message)
                        percept = [p + e for p, e in zip(percept, error, strict=True)]
                        motions, lost = motions + 1, novelty > self.models.most_novel
                    else:
                        outcome = 1
                case "Detect":  # Γ predicts what would be perceived
                    pass
                case "Grasp":
                    outcome = int(lost or self.success(percept) <= 0.5)
                case "ContinuousNN":
                    message = network(percept, state.parameters, 3)
                case "BranchingNN":
                    first, second = map(sigmoid, network(percept, state.parameters, 2))
                    outcome = int(second > first)
                case unknown:
                    raise ValueError(f"no state machine knows the action {unknown!r}")
            head = state.heads[outcome]
            if head is None:
                return True, percept, step
            node = head
        return False, percept, max_transitions

    def success(self, percept: Row) -> float:
        """C(p), the probability that a grasp succeeds."""
        *box, x, y, z = percept
        far = max(math.hypot(x, y), 1e-6)
        features = [0.5 * math.tanh(side / 0.5) for side in box]
        features += [4.0 * far, 2.0 * x / far, 2.0 * y / far, 3.0 * z]
        row = [
            (f - m) / s for f, m, s in zip(features, self.seen_mean, self.seen_scale, strict=False)
        ]
        slope, offset = self.models.platt
        return sigmoid(-(slope * self.svc.decision_function([row])[0] + offset))

    def gamma(self, percept: Row, motion: Row) -> tuple[Row, float]:
        """Γ(p, u): the next percept, and how novel the motion is."""
        x0, x1, y0, y1, ox, oy, oz = percept
        dx, dy, turn = motion
        cx, cy, w, h = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
        a, b = self.sides
        sine = max((w * w + h * h - a * a - b * b) / (2 * a * b), 0.0)
        yaw = math.atan2(sine, (h * h - w * w) / max(b * b - a * a, 1e-9)) / 2
        u, v = ox - cx, oy - cy
        yaw = -yaw if u * v < 0 else yaw
        c, s = math.cos(yaw), math.sin(yaw)
        places = [abs(c * u + s * v), abs(c * v - s * u), abs(c * u - s * v), abs(c * v + s * u)]
        row = np.array([(f - m) / k for f, m, k in zip(places, self.mean, self.scale, strict=True)])
        value = self.svr.predict(row[None])[0]
        away = self.models.transition.centres - row
        distance = np.einsum("md,md->m", away, away).min()
        tw, th = turned(yaw, a, b)
        extremes = math.hypot(ox, oy), math.hypot(dx, dy), abs(turn), math.hypot(w - tw, h - th)
        beyond = sum(max(e / most - 1, 0.0) for e, most in zip(extremes, self.most, strict=True))
        novelty = 1 - 2.0 ** -(distance / self.models.reach + beyond / 0.1)
        (w1, h1), (w2, h2) = turned(yaw - turn, a, b), turned(-yaw - turn, a, b)
        weight = math.sin(math.pi / 2 * min(max(value, -1.0), 1.0)) / 2
        gap = (w - h) * math.cos(2 * turn)
        loose, trust = ((w + h + gap) / 2, (w + h - gap) / 2), self.models.trust
        w = loose[0] + trust * ((w1 + w2) / 2 + weight * (w1 - w2) - loose[0])
        h = loose[1] + trust * ((h1 + h2) / 2 + weight * (h1 - h2) - loose[1])
        c, s = math.cos(turn), math.sin(turn)
        cx, cy, ox, oy = cx - dx, cy - dy, ox - dx, oy - dy
        cx, cy, ox, oy = c * cx + s * cy, c * cy - s * cx, c * ox + s * oy, c * oy - s * ox
        return [cx - w / 2, cx + w / 2, cy - h / 2, cy + h / 2, ox, oy, oz], float(novelty)

    def possible(self, percept: Row, motion: Row) -> bool:
        """Whether the base can drive and turn so without touching the table's box."""
        box, (dx, dy, turn) = percept[:4], motion
        if not math.hypot(dx, dy) <= MAX_TRANSLATION or not math.isfinite(turn):
            return False
        if box[1] <= box[0] or box[3] <= box[2]:
            return True
        end = [[x + dx, y + dy] for x, y in self.body]
        if overlap([*self.body, *end], box, [(-dy, dx)]):
            return False
        gap = max(box[0] - dx, dx - box[1], 0.0), max(box[2] - dy, dy - box[3], 0.0)
        if turn == 0 or math.hypot(*gap) >= self.radius:
            return True
        turn = (turn + math.pi) % (2 * math.pi) - math.pi
        for k in range(1, TURNS + 1):
            c, s = math.cos(turn * k / TURNS), math.sin(turn * k / TURNS)
            body = [[dx + c * x - s * y, dy + s * x + c * y] for x, y in self.body]
            if overlap(body, box, [(c, s), (-s, c)]):
                return False
        return True


def overlap(polygon: list[Row], box: Row, axes: list[tuple[float, float]]) -> bool:
    """Whether a convex polygon and a box share a point; `axes` are the polygon's own normals."""
    x0, x1, y0, y1 = box
    xs, ys = [p[0] for p in polygon], [p[1] for p in polygon]
    if max(xs) < x0 or x1 < min(xs) or max(ys) < y0 or y1 < min(ys):
        return False
    for a, b in axes:
        along = [a * x + b * y for x, y in polygon]
        low = min(a * x0, a * x1) + min(b * y0, b * y1)
        high = max(a * x0, a * x1) + max(b * y0, b * y1)
        if max(along) < low or high < min(along):
            return False
    return True


def turned(yaw: float, a: float, b: float) -> tuple[float, float]:
    """Extents of the box of a rectangle of sides a and b (m), the first along x at yaw 0."""
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    return a * c + b * s, a * s + b * c


def network(inputs: Row, weights: Row, outputs: int) -> Row:
    """One hidden layer of sigmoids, linear outputs; weights W1, b1, W2, b2 flattened."""
    n = len(inputs)
    biases, second = HIDDEN * n, HIDDEN * (n + 1)
    hidden = [
        sigmoid(
            sum(w * x for w, x in zip(weights[k * n : (k + 1) * n], inputs, strict=True))
            + weights[biases + k]
        )
        for k in range(HIDDEN)
    ]
    last = second + outputs * HIDDEN
    return [
        sum(weights[second + k * HIDDEN + j] * hidden[j] for j in range(HIDDEN)) + weights[last + k]
        for k in range(outputs)
    ]


def sigmoid(x: float) -> float:
    """The logistic function, which saturates where its exponential would overflow."""
    return 1 / (1 + math.exp(min(-x, 700.0)))


def run_all(
    simulation: Simulation, machines: list[StateMachine], scenarios: int, max_transitions: int
) -> tuple[Array, Array, Array]:
    """Success (P, B), last percepts (P, B, 7) and transitions (P, B) of all on all scenarios."""
    runs = [
        simulation.run(machine, scenario, max_transitions)
        for machine in machines
        for scenario in range(scenarios)
    ]
    shape = (len(machines), scenarios)
    succeeded, percept, transitions = (np.array(part) for part in zip(*runs, strict=True))
    return succeeded.reshape(shape), percept.reshape(*shape, -1), transitions.reshape(shape)
