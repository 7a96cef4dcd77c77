"""The cost of more individuals, and of more room for nodes: time and memory."""

import ctypes
import itertools
from functools import partial
from pathlib import Path

import torch

from benchmarks.measure import (
    WALL,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    Work,
    cores,
    in_turns,
    run_threads,
)
from benchmarks.workload import (
    CAPACITY,
    POPULATION,
    Workload,
    evolved_population,
    later_population,
    workload,
)
from cgtorch.evolution import EvolutionSettings, EvolutionState, Population, tell
from cgtorch.evolution.fitness import evaluator
from cgtorch.graphs import Graphs, widened
from cgtorch.simulation import rollout

SIZES = (100, 1000, 10_000, 100_000)
REPEATS = 5  # where one call takes long


def growth_10x(effort: Effort) -> Line:
    """The cost of ten times the population: of rollouts, and of a whole generation.

    Selection of 10,000 may take long, so a quick run leaves the generation out.
    """
    work = workload()
    sizes = SIZES if effort.size == 1 else SIZES[:-1]
    with run_threads(cores()):
        parts = [_rollouts(work, *pair, effort.repeats) for pair in itertools.pairwise(sizes)]
        if effort.size == 1:
            parts.append(_generations(work, POPULATION, 10 * POPULATION, REPEATS))
    return Line(
        name="growth_10x",
        compared="seconds for ten times the population / for the population; of rollouts, for as "
        "many executed transitions each, as random children need not all be as busy",
        unit="x the time",
        target=10.5,
        clock="wall",
        threads=cores(),
        parts=tuple(parts),
        at_most=True,
    )


def _rollouts(work: Workload, fewer: int, more: int, repeats: int) -> Comparison:
    both = [later_population(size).graphs for size in (fewer, more)]
    works: list[Work] = [partial(rollout, g, work.actions, work.environment) for g in both]
    memory = [peak_memory(each) for each in works]
    done = [rollout(g, work.actions, work.environment).executed for g in both]
    # The few take a moment: as many calls of them as one call of the many takes.
    other, ours = in_turns(
        works, repeats if more < SIZES[-1] else REPEATS, WALL, calls=[5, 1], warm_up=0
    )
    rates = done[0] / other.median, done[1] / ours.median
    return Comparison(
        label=f"rollouts, {fewer} → {more} x {work.environment.num_scenarios}",
        ours=ours,
        other=other,
        ratio=more / fewer * rates[0] / rates[1],
        difference=None,
        sizes={
            "transitions": done[1],
            "transitions_per_second": rates[1],
            "transitions_per_second of the fewer": rates[0],
            "peak memory MiB": memory[1],
            "peak memory MiB of the fewer": memory[0],
        },
        note=f"{rates[0]:.3g} → {rates[1]:.3g} executed transitions/s, {_arrow(memory)}",
    )


def _generations(work: Workload, fewer: int, more: int, repeats: int) -> Comparison:
    works: list[Work] = [partial(generation, work, later_population(n)) for n in (fewer, more)]
    memory = [peak_memory(each) for each in works]
    other, ours = in_turns(works, repeats, WALL, calls=[3, 1], warm_up=0)
    return Comparison(
        label=f"generation, {fewer} → {more} x {work.environment.num_scenarios}",
        ours=ours,
        other=other,
        ratio=ours.median / other.median,
        difference=None,
        sizes={"peak memory MiB": memory[1], "peak memory MiB of the fewer": memory[0]},
        note=_arrow(memory),
    )


def generation(work: Workload, population: Population, capacity: int = CAPACITY) -> EvolutionState:
    """Evaluate a population and make the next one, with graphs of at most `capacity` nodes."""
    settings = EvolutionSettings(population=len(population), capacity=capacity)
    state = EvolutionState(population, 0, population[:1], 0.0)
    keep = torch.zeros(work.environment.num_scenarios, dtype=torch.bool)
    result = evaluator(work.actions, work.environment, keep)(population.graphs)
    generator = torch.Generator().manual_seed(7)
    return tell(state, result.fitness, settings, work.actions, generator, result.scores)


def padding(effort: Effort) -> Line:
    """The cost of twice the room for nodes, for graphs that do not need it: in rollouts, in all."""
    work, population = workload(), evolved_population()
    graphs, capacities = population.graphs, (2 * CAPACITY, CAPACITY)
    successors = [generation(work, population, c).population for c in capacities]
    if not equal(successors[0].graphs, successors[1].graphs):
        raise DisagreementError("with more room other children come about; nothing was timed")
    with run_threads(cores()):
        parts = _padded_rollouts(work, *(widened(graphs, c) for c in capacities), effort.repeats)
        works: list[Work] = [partial(generation, work, population, c) for c in capacities]
        ours, other = in_turns(works, 2 * effort.repeats, WALL)
    label = f"generation, {POPULATION} x {work.environment.num_scenarios}"
    whole = Comparison(label, ours, other, ours.median / other.median, None)
    return Line(
        name="padding",
        compared=f"seconds with {2 * CAPACITY} node slots / with {CAPACITY}, the same graphs",
        unit="x the time",
        target=1.05,
        clock="wall",
        threads=cores(),
        parts=(parts, whole),
        at_most=True,
    )


def equal(first: Graphs, second: Graphs) -> bool:
    """Whether graphs are the same to the last bit."""
    pairs = zip(vars(first).values(), vars(second).values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def _padded_rollouts(work: Workload, wide: Graphs, graphs: Graphs, repeats: int) -> Comparison:
    results = [rollout(g, work.actions, work.environment) for g in (wide, graphs)]
    pairs = zip(vars(results[0]).values(), vars(results[1]).values(), strict=True)
    same = (torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in pairs)
    if not all(same):
        raise DisagreementError("graphs with more room run otherwise; nothing was timed")
    works: list[Work] = [
        partial(rollout, g, work.actions, work.environment) for g in (wide, graphs)
    ]
    # A small difference of large numbers: more samples than elsewhere.
    ours, other = in_turns(works, 2 * repeats, WALL)
    label = f"rollouts, {len(graphs)} x {work.environment.num_scenarios}"
    return Comparison(label, ours, other, ours.median / other.median, 0.0)


def _arrow(memory: list[float]) -> str:
    return f"{memory[0]:.0f} → {memory[1]:.0f} MiB"


def peak_memory(work: Work) -> float:
    """The peak memory of a call, in MiB; 0 if the system does not report it."""
    try:
        # What the allocator only keeps for later goes back, and the peak begins anew.
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        before = _memory("VmRSS")
        work()
        return _memory("VmHWM") - before
    except (AttributeError, OSError):
        return 0.0


def _memory(name: str) -> float:
    """A memory figure of this process from Linux, in MiB."""
    rows = Path("/proc/self/status").read_text().splitlines()
    return int(next(row for row in rows if row.startswith(name)).split()[1]) / 1024
