"""One generation of evolution, split into what it is made of."""

import copy
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch

from benchmarks.measure import Comparison, Effort, Line, cores, timing, torch_threads
from benchmarks.stopwatch import Stopwatch
from benchmarks.workload import Workload, populations, workload
from cgtorch.actions import ActionSet, paper_actions
from cgtorch.actions.networks import BranchingNN, ContinuousNN
from cgtorch.evolution import EvolutionSettings, Generation, Island, Population
from cgtorch.evolution.evolution import EvolutionState, tell
from cgtorch.evolution.fitness import evaluate
from cgtorch.evolution.selection import ranking
from cgtorch.improvement.events import GenerationDone
from cgtorch.report.tensorboard import TensorBoardWatch
from cgtorch.simulation import ModelEnvironment

MODELS = ("Γ", "C", "networks")
"""What a generation is for; the rest is overhead."""
PARTS = (*MODELS, "possible motions", "rest of rollouts", "selection", "operators", "logging")
LOGGED = 20  # generations that are logged for each that is timed; one in 20 has histograms


@dataclass(frozen=True)
class Timed:
    """The workload with timers around Γ, C, the check of motions and the networks."""

    watch: Stopwatch
    environment: ModelEnvironment
    actions: ActionSet


def overhead_share(effort: Effort) -> Line:
    """What part of a generation is neither Γ, C nor the networks."""
    work = workload()
    with torch_threads(cores()):
        parts = tuple(
            _split(work, population, label, effort.repeats)
            for label, population in populations().items()
        )
    return Line(
        name="overhead_share",
        compared="seconds of a generation that are not Γ, C or networks / the whole generation: "
        "evaluate, tell and a TensorBoard event",
        unit="of a generation",
        target=0.3,
        clock="wall",
        threads=cores(),
        parts=parts,
        at_most=True,
    )


def _split(work: Workload, population: Population, label: str, repeats: int) -> Comparison:
    timed = with_timers(work)
    with logger(timed) as log:
        samples = [generation_split(timed, population, log) for _ in range(repeats + 1)][1:]
    whole = [sum(sample.values()) for sample in samples]
    overhead = [sum(v for k, v in sample.items() if k not in MODELS) for sample in samples]
    shares = {
        name: statistics.median(s[name] / total for s, total in zip(samples, whole, strict=True))
        for name in PARTS
    }
    p, b = len(population), work.environment.num_scenarios
    return Comparison(
        label=f"{label}, {p} x {b}",
        ours=timing(overhead),
        other=timing(whole),
        ratio=statistics.median(o / w for o, w in zip(overhead, whole, strict=True)),
        difference=None,
        sizes={
            "population": p,
            "scenarios": b,
            **{f"{name} s": statistics.median(s[name] for s in samples) for name in PARTS},
        },
        note=", ".join(f"{name} {share:.0%}" for name, share in shares.items()),
    )


def with_timers(work: Workload) -> Timed:
    """The workload's environment and actions of its own, timed; the library knows nothing of it."""
    watch, environment, actions = Stopwatch(), copy.copy(work.environment), paper_actions()
    environment.gamma = watch.around("Γ", environment.gamma)
    environment.classifier = watch.around("C", environment.classifier)
    environment.possible = watch.around("possible motions", environment.possible)
    for action in actions.actions:
        if isinstance(action, ContinuousNN | BranchingNN):
            forward: Any = watch.around("networks", action.forward)
            action.forward = forward  # type: ignore[method-assign]
    return Timed(watch, environment, actions)


@contextmanager
def logger(timed: Timed) -> Iterator[TensorBoardWatch]:
    """A run's TensorBoard files, in a folder that goes again."""
    with (
        tempfile.TemporaryDirectory() as folder,
        TensorBoardWatch(folder, {}, actions=timed.actions) as log,
    ):
        yield log


def generation_split(
    timed: Timed, population: Population, log: TensorBoardWatch
) -> dict[str, float]:
    """Seconds of each of `PARTS` in one generation that begins with this population."""
    watch, generator = timed.watch, torch.Generator().manual_seed(6)
    select = watch.around("selection", EvolutionSettings().selection)
    settings = EvolutionSettings(population=len(population), selection=select)
    keep = torch.zeros(timed.environment.num_scenarios, dtype=torch.bool)
    watch.taken()
    with watch.running("rollouts"):
        result = evaluate(population.graphs, timed.actions, timed.environment, keep)
    rollouts = watch.taken()
    with watch.running("operators"):
        best = int(ranking(result.fitness, population.graphs.num_nodes)[0])
        state = EvolutionState(population, 0, population[:1], 0.0)
        tell(state, result.fitness, settings, timed.actions, generator, result.scores)
    after = watch.taken()
    solved, fitness = result.succeeded[best], float(result.fitness[best])
    champion, islands = population[best : best + 1], [Island(state, generator)]
    with watch.running("logging"):
        for number in range(LOGGED):
            done = Generation(
                number, islands, result.fitness, champion, fitness, solved, result.transitions
            )
            log(GenerationDone("S0", "S0", done, 150, 0, 0, int(solved.sum()), len(keep), 1.0))
    logged = watch.taken()["logging"] / LOGGED
    inside = {name: rollouts.get(name, 0.0) for name in (*MODELS, "possible motions")}
    return inside | {
        "rest of rollouts": rollouts["rollouts"] - sum(inside.values()),
        "selection": after["selection"],
        "operators": after["operators"] - after["selection"],
        "logging": logged,
    }
