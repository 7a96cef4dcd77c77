"""The time of one generation of evolution, by part."""

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import torch

from benchmarks.measure import Comparison, Effort, Line, cores, run_threads, timing
from benchmarks.stopwatch import Stopwatch
from benchmarks.workload import POPULATION, Workload, larger_workload, workload
from cgtorch.evolution import EvolutionSettings, Generation, Population, search
from cgtorch.evolution.fitness import Evaluation, Evaluator, evaluator
from cgtorch.evolution.racing import MakeEvaluator
from cgtorch.graphs import Graphs
from cgtorch.improvement.events import GenerationDone
from cgtorch.report.tensorboard import TensorBoardWatch
from cgtorch.simulation import MAX_STEPS, MAX_TRANSITIONS
from cgtorch.simulation.rollout import engine_of

MODELS = ("Γ", "C", "networks")
"""The necessary parts of a generation; the rest is overhead."""
INSIDE = (*MODELS, "possible motions")
"""The parts that compiled code can repeat, in the order of program.h."""
PARTS = (*INSIDE, "rest of rollouts", "selection", "operators", "logging")
MORE, TRIES = 2, 4
LOOKED_AT, LATER = (1, 10, 50), (10,)
"""The generations that are measured, of which a search in a training has 5 to more than 100. One
event in twenty has histograms, which take 1 ms more."""
HISTOGRAMS_EVERY = 20  # generations


@dataclass(frozen=True)
class Looked:
    """A generation in the middle of an evolution.

    Attributes:
        population: Its individuals.
        seconds: Of rollouts, selection, operators and logging, which are all of its time.
    """

    population: Population
    seconds: dict[str, float]


def overhead_share(effort: Effort) -> Line:
    """Overhead outside model inference, as a share of a generation."""
    parts = (*_parts(workload(), LOOKED_AT, effort), *_parts(larger_workload(), LATER, effort))
    return Line(
        name="overhead_share",
        compared="seconds of a generation that are not Γ, C or networks / the whole generation "
        "with its TensorBoard event, in the middle of an evolution",
        unit="of a generation",
        target=0.3,
        clock="wall",
        threads=cores(),
        parts=parts,
        at_most=True,
    )


def _parts(work: Workload, numbers: tuple[int, ...], effort: Effort) -> list[Comparison]:
    """A comparison for each of some generations."""
    with run_threads(cores()):
        samples = [_sample(work, numbers) for _ in range(effort.repeats + 1)][1:]
    scenarios = work.environment.num_scenarios
    return [_comparison(n, scenarios, [sample[n] for sample in samples]) for n in numbers]


def _sample(work: Workload, numbers: tuple[int, ...]) -> dict[int, dict[str, float]]:
    """Seconds of each of `PARTS` in each of the measured generations."""
    looked = one_evolution(work, POPULATION, numbers)
    return {number: generation_split(work, each) for number, each in looked.items()}


def _comparison(number: int, scenarios: int, samples: list[dict[str, float]]) -> Comparison:
    whole = [sum(sample.values()) for sample in samples]
    overhead = [sum(v for k, v in sample.items() if k not in MODELS) for sample in samples]
    shares = {
        name: statistics.median(s[name] / total for s, total in zip(samples, whole, strict=True))
        for name in PARTS
    }
    return Comparison(
        label=f"generation {number}, {POPULATION} x {scenarios}",
        ours=timing(overhead),
        other=timing(whole),
        ratio=statistics.median(o / w for o, w in zip(overhead, whole, strict=True)),
        difference=None,
        sizes={
            "population": POPULATION,
            "scenarios": scenarios,
            "generation": number,
            **{f"{name} s": statistics.median(s[name] for s in samples) for name in PARTS},
        },
        note=", ".join(f"{name} {share:.0%}" for name, share in shares.items()),
    )


def generation_split(work: Workload, looked: Looked) -> dict[str, float]:
    """Seconds of each of `PARTS`."""
    inside = dict(zip(INSIDE, rollout_parts(work, looked.population), strict=True))
    others = dict(looked.seconds)
    return inside | {"rest of rollouts": others.pop("rollouts") - sum(inside.values())} | others


def one_evolution(work: Workload, size: int, numbers: tuple[int, ...]) -> dict[int, Looked]:
    """Generations of an evolution as a search runs it, each with its TensorBoard event.

    Args:
        work: the environment and the actions.
        size: of the population.
        numbers: of the generations, counted from 0.
    """
    watch, settings = Stopwatch(), EvolutionSettings(population=size)
    select = watch.around("selection", settings.selection)
    evaluated, received, logged = list[tuple[float, float]](), list[float](), list[float]()
    how = {"selection": select, "evaluate": _timed(evaluated)}
    settings = EvolutionSettings(population=size, **how)
    selection, populations = list[float](), dict[int, Population]()
    seed = torch.Generator().manual_seed(2)
    with _logger(work) as log:
        evolution = search.evolve(work.environment, work.actions, settings, seed)
        for generation in islice(evolution, max(numbers) + 2):
            received.append(time.perf_counter())
            selection.append(watch.taken().get("selection", 0.0))
            log(_event(generation))
            logged.append(time.perf_counter())
            if generation.number in numbers:
                populations[generation.number] = generation.population
    logs = [end - begin for begin, end in zip(received, logged, strict=True)]
    logging = statistics.mean(
        statistics.median(logs[i::HISTOGRAMS_EVERY])
        for i in range(min(HISTOGRAMS_EVERY, len(logs)))
    )
    found = {}
    for number in numbers:
        begin, end = evaluated[number]
        rest = received[number] - end + evaluated[number + 1][0] - logged[number]
        selected = selection[number + 1]  # after the event, before the next is evaluated
        seconds = {
            "rollouts": end - begin,
            "selection": selected,
            "operators": rest - selected,
            "logging": logging,
        }
        found[number] = Looked(populations[number], seconds)
    return found


def _event(generation: Generation) -> GenerationDone:
    solved, count = int(generation.succeeded.sum()), len(generation.succeeded)
    return GenerationDone("S0", "S0", 0, 0, solved, count, generation, 150, 1.0)


def _timed(times: list[tuple[float, float]]) -> MakeEvaluator:
    """`evaluator`, which notes when each evaluation of a search begins and ends."""

    def timed(*args: Any, **named: Any) -> Evaluator:
        inner = evaluator(*args, **named)

        def evaluation(graphs: Graphs) -> Evaluation:
            begin = time.perf_counter()
            found = inner(graphs)
            times.append((begin, time.perf_counter()))
            return found

        return evaluation

    return timed


@contextmanager
def _logger(work: Workload) -> Iterator[TensorBoardWatch]:
    """A run's TensorBoard files, in a folder that goes again."""
    with (
        tempfile.TemporaryDirectory() as folder,
        TensorBoardWatch(folder, {}, actions=work.actions) as log,
    ):
        yield log


def rollout_parts(work: Workload, population: Population) -> list[float]:
    """Seconds of Γ, C, networks and checks of motions in an evaluation on all cores.

    Each part is repeated `MORE` times wherever it runs, and the additional time of the evaluation
    is measured. Repeated work finds everything in the CPU's caches, so these times are rather too
    small, and the overhead too large. No clock is read within an evaluation: reading it takes
    longer than some of the parts, and unfinished work continues beyond it.
    """
    engine = engine_of(work.actions, work.environment)
    assert engine is not None, "this line measures compiled code; install a C compiler"  # noqa: S101
    call = partial(
        engine.evaluation,
        population.graphs,
        scenarios=torch.arange(work.environment.num_scenarios),
        kept=0,
        max_transitions=MAX_TRANSITIONS,
        max_steps=MAX_STEPS,
    )
    once, *more = torch.cat([torch.zeros(1, len(INSIDE)), MORE * torch.eye(len(INSIDE))]).long()
    alone, *longer = (_least_seconds(partial(call, again=each)) for each in (once, *more))
    return [max(0.0, seconds - alone) / MORE for seconds in longer]


def _least_seconds(work: Callable[[], object]) -> float:
    """The least of several times, as interrupted calls take longer."""
    found = []
    for _ in range(TRIES):
        begin = time.perf_counter()
        work()
        found.append(time.perf_counter() - begin)
    return min(found)
