"""Algorithm 3 as the paper has it: one skill, one scenario, one action at a time.

Slow and plain, in Python numbers; only what the environment does is asked of the environment.
"""

import itertools
import math
import zlib
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from support import Counter, Visits, Wander
from torch import Tensor

from cgtorch.graphs import (
    Action,
    ActionSet,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    Graphs,
    LinearNN,
    RecurrentNN,
    SubSkill,
    to_networkx,
)
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.tabletop.actions import Detect, Grasp, MoveBase

End = Literal["success", "failure", "timeout"]


class OutOfSteps(Exception):  # noqa: N818
    """The lane has executed as many actions as it may on all levels."""


@dataclass
class Robot:
    """All that a running skill changes."""

    environment: Environment
    scenario: int
    max_steps: int
    percept: Tensor
    state: Tensor
    message: list[float] = field(default_factory=lambda: [0.0] * 8)
    has_message: bool = False
    memory: list[float] = field(default_factory=lambda: [0.0] * 8)
    earlier: list[list[float]] = field(default_factory=list)  # the latest first
    remembered: list[float] = field(default_factory=lambda: [0.0] * 4)
    visits: list[float] = field(default_factory=lambda: [0.0] * 2)
    tired: float = 0.0  # metres that Wander has sent the robot
    draws: int = 0
    steps: int = 0
    seen: list[list[float]] = field(default_factory=list)  # the percept after each action
    ran_out: int | None = None  # actions before any graph first ran out of its transitions

    def lanes(self) -> Lanes:
        return Lanes(
            percept=self.percept[None],
            state=self.state[None],
            message=self.percept.new_tensor([self.message]),
            has_message=torch.tensor([self.has_message]),
            memory=self.percept.new_tensor([self.memory]),
            scenario=torch.tensor([self.scenario]),
            step=torch.tensor([self.steps]),
        )

    def takes(self, lanes: Lanes) -> None:
        self.percept, self.state = lanes.percept[0], lanes.state[0]


def run(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    scenario: int,
    max_transitions: int,
    max_steps: int,
) -> tuple[End, Robot]:
    """How the first graph ends on a scenario, and the robot afterwards."""
    state, percept = environment.start(torch.tensor([scenario]))
    robot = Robot(environment, scenario, max_steps, percept[0], state[0])
    try:
        end = execute_graph(graphs, actions, robot, max_transitions)
    except OutOfSteps:
        end = "timeout"
    return end, robot


def execute_graph(graphs: Graphs, actions: ActionSet, robot: Robot, max_transitions: int) -> End:
    """Lines 1 to 16 of Algorithm 3."""
    view = to_networkx(graphs, actions)
    node = view.graph["start"]
    for _ in range(max_transitions):
        data = view.nodes[node]
        action = actions.actions[actions.names.index(data["action"])]
        outcome = execute_action(action, data["parameters"], robot)
        if outcome in action.terminal:
            return "success" if action.terminal[outcome] else "failure"
        (node,) = [
            head for _, head, edge in view.out_edges(node, data=True) if edge["outcome"] == outcome
        ]
    if robot.ran_out is None:
        robot.ran_out = robot.steps
    return "timeout"


def execute_action(action: Action, parameters: list[float], robot: Robot) -> str:
    """Lines 5 to 7: the action's effect on the robot, and its outcome."""
    if isinstance(action, SubSkill):
        skill = action.skill
        end = execute_graph(skill.graph, skill.actions, robot, skill.max_transitions)
        return "success" if end == "success" else "failure"
    if robot.steps >= robot.max_steps:
        raise OutOfSteps
    outcome = execute_primitive(action, parameters, robot)
    robot.steps += 1
    robot.seen.append(robot.percept.tolist())
    return outcome


def execute_primitive(action: Any, parameters: list[float], robot: Robot) -> str:
    percept = robot.percept.tolist()
    match action:
        case MoveBase():
            if not robot.has_message:
                return "failure"
            control = robot.percept.new_tensor([robot.message[:3]])
            lanes, moved = robot.environment.step(robot.lanes(), control)
            robot.takes(lanes)
            return "success" if moved.item() else "failure"
        case Detect():
            robot.takes(robot.environment.observe(robot.lanes()))
            return "success"
        case Grasp():
            lanes, probability = robot.environment.success(robot.lanes())
            robot.takes(lanes)
            return "success" if probability.item() > 0.5 else "failure"
        case ContinuousNN():
            robot.message[:3] = network(percept, parameters, 3)
            robot.has_message = True
            return "success"
        case BranchingNN():
            first, second = (sigmoid(y) for y in network(percept, parameters, 2))
            return "out2" if second > first else "out1"
        case Wander():
            seed = int(robot.environment.seeds[robot.scenario])  # type: ignore[attr-defined]
            drawn = [x / 2**24 for x in random_numbers(seed, "Wander", robot.draws, 3)]
            robot.draws += 1
            robot.message[:3] = [(x - 0.5) * parameters[0] for x in drawn]
            robot.has_message = True
            robot.tired += math.hypot(*robot.message[:2])
            if robot.tired > 1:
                return "tired"
            side = robot.message[1]
            return "left" if side > 0.1 else "right" if side < -0.1 else "ahead"
        case LinearNN():
            robot.message[:3] = small_layer(percept[: action.inputs], parameters, 3)
            robot.has_message = True
            return "success"
        case DelayNN():
            times = [percept, *robot.earlier][: action.delays + 1]
            times += [[0.0] * len(percept)] * (action.delays + 1 - len(times))
            changes = [
                [10 * (x - y) for x, y in zip(*pair, strict=True)]
                for pair in itertools.pairwise(times)
            ]
            seen = [x for numbers in [percept, *changes] for x in numbers]
            robot.message[:3] = small_layer(seen, parameters, 3)
            robot.has_message = True
            robot.earlier.insert(0, percept)
            return "success"
        case RecurrentNN():
            robot.remembered, robot.message[:3] = remembering(percept, robot.remembered, parameters)
            robot.has_message = True
            return "success"
        case Counter():
            memory = robot.visits if isinstance(action, Visits) else robot.memory
            memory[0] += 1
            memory[1] = percept[4]
            robot.message[3] += parameters[0]
            if percept[4] > 1.2 + abs(parameters[1]):
                return "lost"
            return "enough" if memory[0] + robot.message[3] > 3 else "again"
    raise TypeError(f"the plain interpreter knows no {type(action).__name__}")


def random_numbers(seed: int, who: str, count: int, size: int) -> list[int]:
    """Numbers of 24 bits from Threefry-2x32-20 as its paper states it, one block at a time."""
    word = 2**32 - 1
    key = [seed & word, (seed >> 32) ^ zlib.crc32(who.encode())]
    key.append(key[0] ^ key[1] ^ 0x1BD11BDA)
    found: list[int] = []
    for block in range(-(-size // 2)):
        x, y = (count + key[0]) & word, (block + key[1]) & word
        for step in range(1, 6):
            for turn in ((13, 15, 26, 6), (17, 29, 16, 24))[(step - 1) % 2]:
                x = (x + y) & word
                y = ((y << turn | y >> (32 - turn)) & word) ^ x
            x, y = (x + key[step % 3]) & word, (y + key[(step + 1) % 3] + step) & word
        found += [x >> 8, y >> 8]
    return found[:size]


def network(inputs: list[float], weights: list[float], outputs: int) -> list[float]:
    """A 7-3-outputs network: all weights of the hidden layer, its biases, then the outputs'."""
    rest = iter(weights)
    w1 = [[next(rest) for _ in inputs] for _ in range(3)]
    b1 = [next(rest) for _ in range(3)]
    w2 = [[next(rest) for _ in range(3)] for _ in range(outputs)]
    b2 = [next(rest) for _ in range(outputs)]
    hidden = [
        sigmoid(b + sum(w * x for w, x in zip(row, inputs, strict=True)))
        for row, b in zip(w1, b1, strict=True)
    ]
    return [
        b + sum(w * h for w, h in zip(row, hidden, strict=True))
        for row, b in zip(w2, b2, strict=True)
    ]


def remembering(
    inputs: list[float], state: list[float], parameters: list[float]
) -> tuple[list[float], list[float]]:
    """A network that reads what it has said to itself before: its next state, and its message."""
    rest = iter(parameters)
    seen = [*inputs, *state]
    wr = [[next(rest) / 2 for _ in seen] for _ in state]
    b = [next(rest) / 100 for _ in state]
    v = [[next(rest) / 2 for _ in state] for _ in range(3)]
    c = [next(rest) / 100 for _ in range(3)]
    after = [
        math.tanh(bias + sum(w * x for w, x in zip(row, seen, strict=True)))
        for row, bias in zip(wr, b, strict=True)
    ]
    return after, [
        bias + sum(w * h for w, h in zip(row, after, strict=True))
        for row, bias in zip(v, c, strict=True)
    ]


def small_layer(inputs: list[float], parameters: list[float], outputs: int) -> list[float]:
    """V x + c, of parameters that count a half in V and a hundredth in c."""
    size = len(inputs)
    rows = [parameters[i * size : (i + 1) * size] for i in range(outputs)]
    biases = parameters[outputs * size : outputs * (size + 1)]
    return [
        bias / 100 + sum(w / 2 * x for w, x in zip(row, inputs, strict=True))
        for row, bias in zip(rows, biases, strict=True)
    ]


def sigmoid(x: float) -> float:
    return 1 / (1 + math.exp(-x))
