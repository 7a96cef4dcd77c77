"""A GPU beside all cores of its machine: rollouts and whole generations, with equal results."""

import copy
from collections.abc import Callable
from dataclasses import replace

import click
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
from benchmarks.workload import CAPACITY, Workload, later_population, workload
from cgtorch.evolution import EvolutionSettings, EvolutionState
from cgtorch.evolution.evolution import next_state
from cgtorch.evolution.fitness import evaluator
from cgtorch.evolution.population import Population
from cgtorch.evolution.selection import Evaluated
from cgtorch.native.gpu import launcher_of
from cgtorch.simulation import ModelEnvironment, Rollouts, rollout
from cgtorch.tabletop.world import ClearMotion

GPU = torch.device("cuda", 0)
GENERATIONS = {10_000: 10, 100_000: 40, 1_000_000: 80}
"""The target speed-up of whole generations over the cores, by population size."""
ROLLOUTS = 100_000, 30


def gpu_rollouts(effort: Effort) -> Line:
    """Rollouts of evolved graphs on the GPU."""
    (size, target), work, there = ROLLOUTS, workload(), _there()
    population = later_population(int(size * effort.size))
    moved = population.graphs.to(GPU)

    def ours() -> Rollouts:
        found = rollout(moved, work.actions, there)
        torch.cuda.synchronize()
        return found

    def other() -> Rollouts:
        return rollout(population.graphs, work.actions, work.environment)

    one, two = ours(), other()
    for name in ("succeeded", "percept", "state", "transitions"):
        _check_same(name, getattr(one, name), getattr(two, name))
    label = f"{len(population)} x {work.environment.num_scenarios}"
    part = _compared(label, ours, other, effort)
    rate = two.executed / part.ours.median / 1e6
    part = replace(part, note=f"{rate:.0f} million executed transitions per second")
    return _line("gpu_rollouts", "rollouts", target, part)


def gpu_generation(size: int, effort: Effort) -> Line:
    """Evaluation, ranking, selection and operators of a generation on the GPU."""
    work, there, population = workload(), _there(), later_population(int(size * effort.size))
    ours = _generation(work, there, population.to(GPU), GPU)
    other = _generation(work, work.environment, population, torch.device("cpu"))
    one, two = ours().population, other().population
    for name, tensor in vars(two.graphs).items():
        _check_same(name, getattr(one.graphs, name), tensor)
    _check_same("strategies", one.strategy, two.strategy)
    part = _compared(f"population {len(population)}", ours, other, effort)
    return _line(f"gpu_generation_{size}", "whole generations", GENERATIONS[size], part)


def _generation(
    work: Workload, environment: ModelEnvironment, population: Population, device: torch.device
) -> Callable[[], EvolutionState]:
    """One generation, always the same."""
    keep = torch.zeros(environment.num_scenarios, dtype=torch.bool, device=device)
    evaluation = evaluator(work.actions, environment, keep)
    settings = EvolutionSettings(population=len(population), capacity=CAPACITY)
    state = EvolutionState(population, 0, population[:1], 0.0)

    def generation() -> EvolutionState:
        generator, found = torch.Generator().manual_seed(0), evaluation(population.graphs)
        begun = replace(state, generator=generator)
        evaluated = Evaluated(population, found.fitness, found.scores)
        next_one = next_state(begun, evaluated, settings, work.actions)
        if device.type == "cuda":
            torch.cuda.synchronize()
        return next_one

    return generation


def _there() -> ModelEnvironment:
    """The workload's models on the GPU; an error without one."""
    if not torch.cuda.is_available() or launcher_of(GPU) is None:
        raise click.ClickException("there is no GPU with driver and NVRTC; leave --device cuda out")
    environment = workload().environment
    errors, way = environment.errors, environment.possible
    gamma = copy.deepcopy(environment.gamma.__self__).to(GPU)  # type: ignore[attr-defined]
    return ModelEnvironment(
        environment.percepts.to(GPU),
        gamma.predict_with_novelty,
        copy.deepcopy(environment.classifier).to(GPU),  # type: ignore[attr-defined]
        ClearMotion(way.footprint.to(GPU)),  # type: ignore[attr-defined]
        environment.control_size,
        None if errors is None else errors.to(GPU),
        environment.most_novel,
        compiled=environment.compiled,
        chance=environment.first_state[:, 2].to(GPU),
    )


def _check_same(name: str, found: Tensor, wanted: Tensor) -> None:
    if not torch.equal(found.cpu(), wanted):
        raise DisagreementError(f"results differ in {name}; nothing was timed")


def _compared(
    label: str, ours: Callable[[], object], other: Callable[[], object], effort: Effort
) -> Comparison:
    with run_threads(cores()):
        mine, theirs = in_turns([ours, other], effort.repeats, WALL)
    return Comparison(label, mine, theirs, theirs.median / mine.median, 0.0)


def _line(name: str, what: str, target: float, part: Comparison) -> Line:
    compared = f"{what} on {cores()} cores / on {torch.cuda.get_device_name()}, the same bits"
    return Line(name, compared, "x as fast", target, "wall", cores(), (part,))
