"""A cart on a rail as a robot of its own: no batch, no seed, and nothing that is put back."""

import json
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import networkx as nx
import torch
from support import seeded

from cgtorch import Field
from cgtorch.domains.live import OnRobot, domain_of_driver, on_robot
from cgtorch.domains.robot import RobotDriver
from cgtorch.graphs import Graphs, Skill, from_networkx
from cgtorch.ground.environment import start_lanes
from cgtorch.ground.files import JsonLines

END, NEAR = 2.0, 0.3


class CartDriver(RobotDriver):
    """It perceives where it is and what its wheel shows, is pushed, and should come to 0.

    `script` maps the number of an action to what happens before it is done; `calls` are all calls.
    """

    percept = (Field("place", "m", -END, END), Field("wheel", "rad", kind="angle"))
    control = (Field("push", "m", -1, 1),)
    kinds = ("near", "far")

    def __init__(self, seed: int = 0) -> None:
        self.chance, self.place = random.Random(seed), 0.0
        self.script: dict[int, Callable[[], Any]] = {}
        self.calls: list[str] = []
        self.actions = self.stopped = 0

    def perceive(self) -> Sequence[float]:
        self.calls.append("perceive")
        return [self.place, self.place % 1]

    def arrange(self, kind: str) -> None:
        self.calls.append(f"arrange {kind}")
        far = END if kind == "far" else END / 2
        self.place = self.chance.uniform(-far, far)

    def step(self, control: Sequence[float]) -> bool:
        (push,) = control
        self.calls.append("step")
        found = self._scripted()
        if abs(self.place + push) > END:
            return False
        self.place += push
        return True if found is None else found

    def test(self) -> bool:
        self.calls.append("test")
        found = self._scripted()
        return abs(self.place) < NEAR if found is None else found

    def stop(self) -> None:
        self.stopped += 1

    def _scripted(self) -> Any:
        self.actions += 1
        return self.script.get(self.actions, lambda: None)()


def cart(path: Path, driver: RobotDriver | None = None) -> OnRobot:
    """The domain of the cart, with a log there."""
    driver = driver or CartDriver()
    return on_robot(domain_of_driver(type(driver))(), driver, JsonLines(path))


def pusher(domain: OnRobot, speed: float, names: Sequence[str] = ("Aim", "Step", "Test")) -> Skill:
    """Pushes by so much, and tests, over and over."""
    actions = domain.actions()
    view: Any = nx.MultiDiGraph(start=0)
    for i, name in enumerate(names):
        action = actions.actions[actions.index(name)]
        last = [speed] if name == "Aim" else []
        zeros = [0.0] * (action.num_parameters - len(last))
        view.add_node(i, action=name, parameters=[*zeros, *last])
    for i, name in enumerate(names):
        action = actions.actions[actions.index(name)]
        for outcome in action.outcomes:
            if outcome not in action.terminal:
                view.add_edge(i, (i + 1) % len(names), outcome=outcome)
    graph: Graphs = from_networkx(view, actions)
    return Skill(f"push {speed}", graph, actions, 12)


def lines(path: Path, event: str = "") -> list[dict[str, Any]]:
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [row for row in rows if row["event"] == event or not event]


def told(
    domain: Any, kind: str = "near", phase: str = "trials", stage: str = "S0", count: int = 3
) -> Any:
    """A world of some scenes, which has heard for what they are."""
    world = domain.world(domain.draw(kind, count, seeded(0)))
    world.told(phase, stage)
    return world


def begun(domain: Any, row: int = 0, **about: str) -> tuple[Any, Any]:
    """The world and the lane of its scene in this row."""
    world = told(domain, **about)
    return world, start_lanes(world, torch.tensor([row]), 1, 0)


def push(by: float) -> torch.Tensor:
    return torch.tensor([[by]])
