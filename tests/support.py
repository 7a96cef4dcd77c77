"""Actions, environments and populations that many tests use."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import networkx as nx
import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.models import Models
from cgtorch.evolution import EvolutionSettings, Population
from cgtorch.evolution.population import random_population
from cgtorch.graphs import (
    NO_NODE,
    Action,
    ActionSet,
    DelayNN,
    Graphs,
    LinearNN,
    RecurrentNN,
    Skill,
    SubSkill,
    trimmed,
)
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.improvement.checkpoint import Journal
from cgtorch.improvement.setup import Budget, Setup
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, planned_run, write_run
from cgtorch.simulation import ModelEnvironment
from cgtorch.simulation.model import Classifier
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.kinematics import ArmModel
from cgtorch.tabletop.world import LAB_NOISE, Noise, TabletopWorld, random_scenarios

FOOTPRINT = (-0.33, 0.33, -0.33, 0.33)


def models_of(domain: Domain[Any]) -> Models[Any]:
    """The models of a domain, the default ones where it has none."""
    return (domain.models or Models)(domain)


class Counter(Action):
    """Counts its visits in the common memory: "again", then "enough" and, far away, "lost"."""

    outcomes: tuple[str, ...] = ("again", "enough", "lost")
    terminal: Mapping[str, bool] = {"lost": False}
    num_parameters: int = 2
    message_size: int = 4
    memory_size: int = 2

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        memory, message = lanes.memory.clone(), lanes.message.clone()
        memory[:, 0] += 1
        memory[:, 1] = lanes.percept[:, 4]
        # It speaks only in its last number, which no other action overwrites, and reads it back.
        message[:, 3] += parameters[:, 0]
        lost = lanes.percept[:, 4] > 1.2 + parameters[:, 1].abs()
        enough = memory[:, 0] + message[:, 3] > 3
        return replace(lanes, memory=memory, message=message), torch.where(lost, 2, enough.long())


class Wander(Action):
    """Sends a random motion and tells where it leads; after some it is tired."""

    outcomes: tuple[str, ...] = ("left", "ahead", "right", "tired")
    num_parameters: int = 1
    message_size: int = 3
    memory_size: int = 2
    deterministic: bool = False

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, drawn = self.uniform(lanes, environment, 3)
        motion = (drawn - 0.5) * parameters
        side = torch.where(motion[:, 1] > 0.1, 0, torch.where(motion[:, 1] < -0.1, 2, 1))
        memory = lanes.memory.clone()
        memory[:, 0] += motion[:, :2].norm(dim=1)
        outcome = torch.where(memory[:, 0] > 1, 3, side)
        has = torch.ones_like(lanes.has_message)
        message = torch.cat([motion, lanes.message[:, 3:]], 1)
        return replace(lanes, memory=memory, message=message, has_message=has), outcome


def stochastic_actions() -> ActionSet:
    """The paper's actions, one that counts, and one that draws random numbers."""
    return custom_actions().extended(["Wander"], [Wander()])


def seeded(seed: int) -> Generator:
    return torch.Generator().manual_seed(seed)


def random_graphs(
    seed: int, count: int, actions: ActionSet, capacity: int = 12, nodes: tuple[int, int] = (3, 10)
) -> Graphs:
    return random_population(count, actions, capacity, nodes, seeded(seed)).graphs


def random_skill(seed: int, name: str, actions: ActionSet, max_transitions: int = 20) -> Skill:
    """A random skill that visits every sub-skill of its set, if there are any."""
    many = random_graphs(seed, 300, actions, capacity=10, nodes=(6, 10))
    wanted = [i for i, a in enumerate(actions.actions) if isinstance(a, SubSkill)]
    has_all = torch.stack([(many.action == i).any(1) for i in wanted] + [many.num_nodes > 3]).all(0)
    return Skill(name, many[has_all.nonzero()[:1, 0]], actions, max_transitions)


def circle(actions: ActionSet, *names: str) -> Skill:
    """A skill that executes these actions in turns, whatever their outcomes, until one ends it."""
    n = len(names)
    action = torch.tensor([[actions.names.index(name) for name in names]])
    edges = torch.full((1, n, actions.outcome_capacity), -1)
    for slot, name in enumerate(names):
        used = actions.actions[actions.names.index(name)].outcomes
        for outcome, text in enumerate(used):
            ends = text in actions.actions[actions.names.index(name)].terminal
            edges[0, slot, outcome] = -1 if ends else (slot + 1) % n
    parameters = torch.zeros(1, n, actions.parameter_capacity)
    graph = Graphs(action, edges, parameters, torch.zeros(1, dtype=torch.long))
    return Skill("circle", graph, actions, max_transitions=400)


def custom_actions() -> ActionSet:
    """The paper's actions and one of our own."""
    return paper_actions().extended(["Counter"], [Counter()])


class Visits(Counter):
    """Counts, too, but never ends a skill."""

    terminal: Mapping[str, bool] = {}


def recurrent_actions(size: int = 7) -> ActionSet:
    """The paper's actions, two counters, and linear, delay and recurrent networks."""
    paper = paper_actions(size).extended(["Counter"], [Counter()])
    own = [RecurrentNN(size, 4), Visits(), LinearNN(size), DelayNN(size, 2)]
    return paper.extended(["RecurrentNN", "Visits", "LinearNN", "DelayNN"], own)


def nested_actions(
    seed: int = 0, base: ActionSet | None = None, limits: tuple[int, int] = (3, 5)
) -> ActionSet:
    """Base actions and skills, one of them within the other, each with its own limit."""
    base = base or custom_actions()
    inner = random_skill(seed, "S0", base, max_transitions=limits[0])
    one = base.extended(["S0"], [SubSkill(inner)])
    outer = random_skill(seed + 1, "S1", one, max_transitions=limits[1])
    return one.extended(["S1"], [SubSkill(outer)])


def graspable(at: Tensor, table: Tensor) -> Tensor:
    """A simple stand-in for the arms: what is near and in front can be grasped."""
    distance: Tensor = at[:, :2].norm(dim=1)
    return (at[:, 0] > 0.2) & (distance < 1.8) & (at[:, 1].abs() < 0.6)


def world(
    seed: int, count: int, noise: Noise = LAB_NOISE, dtype: torch.dtype = torch.float32
) -> TabletopWorld:
    scenarios = random_scenarios("perimeter", count, seeded(seed))
    pose, table, placed = (x.to(dtype) for x in (scenarios.pose, scenarios.table, scenarios.object))
    scenarios = replace(scenarios, pose=pose, table=table, object=placed)
    made = TabletopWorld(scenarios, graspable, FOOTPRINT, noise)
    made.footprint = made.footprint.to(dtype)
    return made


def model(seed: int, count: int, dtype: torch.dtype = torch.float32) -> ModelEnvironment:
    """Γ, C and obstacles as simple formulas.

    They are rounded from float64: torch's own sine and sigmoid of float32 have another last digit
    for the last rows of a batch.
    """

    def gamma(percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        shift = control[:, [0, 0, 1, 1, 0, 1]]
        turned = torch.cat([percept[:, :6] - shift, percept[:, 6:]], 1)
        more = 0.1 * torch.sin(control[:, 2:].double()).to(dtype)
        return turned + more, torch.zeros_like(control[:, 0])

    def classifier(percept: Tensor) -> Tensor:
        return torch.sigmoid(4 * (1.4 - percept[:, 4:6].double().norm(dim=1))).to(dtype)

    def possible(percept: Tensor, control: Tensor) -> Tensor:
        return (percept[:, 0] - control[:, 0] > 0.3) | (control[:, 1].abs() > 0.5)

    _, percepts = world(seed, count, dtype=dtype).start(torch.arange(count))
    errors = 0.05 * torch.randn(count, 3, 7, generator=seeded(seed))
    return ModelEnvironment(percepts, gamma, classifier, possible, errors=errors)


def judged_by(environment: ModelEnvironment, classifier: Classifier) -> ModelEnvironment:
    """The same models with another C."""
    e = environment
    return ModelEnvironment(
        e.percepts, e.gamma, classifier, e.possible, errors=e.errors, compiled=e.compiled
    )


def as_double(graphs: Graphs) -> Graphs:
    """The same graphs with parameters in float64."""
    return replace(graphs, parameters=graphs.parameters.double())


def as_double_actions(actions: ActionSet) -> ActionSet:
    """The same actions with sub-skills whose parameters are in float64."""

    def made(action: Action) -> Action:
        if not isinstance(action, SubSkill):
            return action
        skill = action.skill
        inner = as_double_actions(skill.actions)
        return SubSkill(replace(skill, graph=as_double(skill.graph), actions=inner))

    return ActionSet(actions.names, tuple(made(a) for a in actions.actions))


def is_valid(graphs: Graphs, actions: ActionSet, index: int = 0, connected: bool = True) -> bool:
    """Whether one graph is valid and its unused places empty, told slot by slot."""
    action, edges = graphs.action[index].tolist(), graphs.edges[index].tolist()
    parameters, start = graphs.parameters[index].tolist(), int(graphs.start[index])
    nodes = {i for i, a in enumerate(action) if a != NO_NODE}
    if start not in nodes:
        return False
    network: nx.MultiDiGraph[int] = nx.MultiDiGraph()
    network.add_nodes_from(nodes)
    for i in range(len(action)):
        if i not in nodes:
            if any(h != NO_NODE for h in edges[i]) or any(x != 0 for x in parameters[i]):
                return False
            continue
        if not 0 <= action[i] < len(actions):
            return False
        module = actions.actions[action[i]]
        if any(x != 0 for x in parameters[i][module.num_parameters :]):
            return False
        for j, head in enumerate(edges[i]):
            leads = j < len(module.outcomes) and module.outcomes[j] not in module.terminal
            if leads != (head in nodes) or (not leads and head != NO_NODE):
                return False
            if leads:
                network.add_edge(i, head)
    return not connected or nx.descendants(network, start) | {start} == nodes


def all_valid(graphs: Graphs, actions: ActionSet, connected: bool = True) -> bool:
    return all(is_valid(graphs, actions, i, connected) for i in range(len(graphs)))


def same_nodes(first: Graphs, second: Graphs) -> bool:
    """Whether graphs have the same nodes in the same order, in whatever slots."""
    return same(trimmed(first), trimmed(second))


def same_individuals(first: Population, second: Population) -> bool:
    """Whether populations have the same graphs, but for unused slots, and strategies."""
    return same_nodes(first.graphs, second.graphs) and torch.equal(first.strategy, second.strategy)


def same(first: Graphs, second: Graphs) -> bool:
    return all(
        torch.equal(a, b) for a, b in zip(vars(first).values(), vars(second).values(), strict=True)
    )


def search(
    actions: ActionSet, evolution: EvolutionSettings, budget: Budget, journal: Journal | None = None
) -> Setup[Any]:
    """What a single evolution needs of a setup: there is no world and nothing to imagine."""
    nothing: Any = None
    return Setup(
        actions,
        world_of=nothing,
        imagine=nothing,
        evolution=evolution,
        budget=budget,
        journal=journal or Journal(),
    )


def tool_pose(arm: ArmModel, q: Tensor) -> Tensor:
    """Poses (..., 4, 4) of an arm's tool frame in the base frame, at joint positions (..., n)."""
    tool = arm.frames(q.reshape(-1, q.shape[-1]))[-1]
    return tool.reshape(*q.shape[:-1], 4, 4)


def create_run(folder: Path, settings: RunSettings, domain_settings: Any = None) -> StoredRun:
    """A run that has just begun in a folder, which holds nothing yet."""
    run = planned_run(folder, settings, domain_settings)
    write_run(run)
    return run
