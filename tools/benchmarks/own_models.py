"""Rollouts in the default Γ and C of a domain beside those of the tabletop."""

import copy
import sys
from functools import partial
from pathlib import Path

import torch
from torch import Generator, Tensor

from benchmarks.measure import WALL, Comparison, Effort, Line, cores, in_turns, run_threads
from benchmarks.workload import SCENARIOS, first_population, workload
from cgtorch.domains.exploration import Exploration
from cgtorch.domains.knowledge import Knowledge
from cgtorch.graphs import ActionSet
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Dataset, Environment
from cgtorch.improvement.trial import first_percepts
from cgtorch.simulation import ModelEnvironment, rollout
from cgtorch.svm.machine import KernelMachine

sys.path.append(str(Path(__file__).parents[2]))
from examples.mountain_car import MountainCar

POPULATIONS = (1000, 10_000)
CENTRES = {"gamma": 128, "classifier": 256}
MOTIONS = 400  # from which the domain's models are learned at most


def own_models(effort: Effort) -> Line:
    """Γ and C of any domain, compiled, in transitions that are executed per second."""
    domain, generator = MountainCar(), torch.Generator().manual_seed(0)
    knowledge = explored(domain, generator)
    world = domain.world(domain.draw("valley", SCENARIOS, generator))
    models = domain.models(domain)
    found = models.imagine(knowledge, first_percepts(world), 1, generator)
    if not isinstance(found, ModelEnvironment):
        raise TypeError(f"MountainCar imagines a {type(found).__name__}; nothing was timed")
    work, car = workload(), resized(found)
    table = resized(work.environment)
    with run_threads(cores()):
        parts = [
            _case((car, domain.actions()), (table, work.actions), size, effort)
            for size in POPULATIONS
        ]
    compared = (
        "executed transitions per second in the default Γ (three outputs) and C of MountainCar / "
        "in the tabletop's (one output), "
        f"{CENTRES['gamma']} and {CENTRES['classifier']} centres each"
    )
    return Line("own_models", compared, "x as fast", 0.5, "wall", cores(), tuple(parts))


def explored(domain: MountainCar, generator: Generator) -> Knowledge:
    """Γ and C of what an exploration has met."""
    models = domain.models(domain)

    def world(kind: str, count: int) -> Environment:
        return domain.world(domain.draw(kind, count, generator))

    def fit(data: Dataset) -> Knowledge:
        return models.fit(data, 0)

    about = Exploration("valley", world, fit, MOTIONS, 2, generator, Purse())
    return fit(models.explore(about))


def resized(environment: ModelEnvironment) -> ModelEnvironment:
    """The same models with so many centres, of which some come again with less weight."""
    gamma = copy.deepcopy(environment.gamma.__self__)  # type: ignore[attr-defined]
    classifier = copy.deepcopy(environment.classifier)
    for model, centres in ((gamma, CENTRES["gamma"]), (classifier, CENTRES["classifier"])):
        _resize(model.machine, centres)  # type: ignore[attr-defined]
    return ModelEnvironment(
        environment.percepts, gamma.predict_with_novelty, classifier, environment.possible,
        environment.control_size, environment.errors, environment.most_novel,
        compiled=environment.compiled,
    )  # fmt: skip


def _resize(machine: KernelMachine, centres: int) -> None:
    rows: Tensor = torch.arange(centres) % len(machine.centres)
    machine.weights = machine.weights[rows] / rows.bincount()[rows][:, None]
    machine.centres, machine.support = machine.centres[rows], machine.support[rows]


def _case(
    ours: tuple[ModelEnvironment, ActionSet],
    other: tuple[ModelEnvironment, ActionSet],
    size: int,
    effort: Effort,
) -> Comparison:
    ways = [
        partial(rollout, first_population(size, actions).graphs, actions, environment)
        for environment, actions in (ours, other)
    ]
    executed = [way().executed for way in ways]
    times = in_turns(ways, effort.repeats, WALL, calls=[5, 5])
    rates = [n / t.median for n, t in zip(executed, times, strict=True)]
    return Comparison(
        label=f"first population, {size} x {SCENARIOS}",
        ours=times[0],
        other=times[1],
        ratio=rates[0] / rates[1],
        difference=None,
        sizes={"executed": executed[0], "executed of the other": executed[1]},
        note=f"{rates[0]:.3g} / {rates[1]:.3g} executed transitions/s",
    )
