"""One generation of evolution, split into what it is made of."""

import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

from benchmarks.measure import Comparison, Effort, Line, cores, timing, torch_threads
from benchmarks.stopwatch import Stopwatch
from benchmarks.workload import Workload, populations, workload
from cgtorch.evolution import EvolutionSettings, Generation, Island, Population
from cgtorch.evolution.evolution import EvolutionState, tell
from cgtorch.evolution.fitness import evaluate
from cgtorch.evolution.selection import ranking
from cgtorch.improvement.events import GenerationDone
from cgtorch.native import function
from cgtorch.native.structures import POINTER
from cgtorch.report.tensorboard import TensorBoardWatch
from cgtorch.simulation import MAX_STEPS, MAX_TRANSITIONS
from cgtorch.simulation.compiled import compiled_evaluation
from cgtorch.simulation.program import compile_graphs

MODELS = ("Γ", "C", "networks")
"""What a generation is for; the rest is overhead."""
INSIDE = (*MODELS, "possible motions")
"""What compiled code counts the ticks of, in the order of rollout.c."""
PARTS = (*INSIDE, "rest of rollouts", "selection", "operators", "logging")
LOGGED = 20  # generations that are logged for each that is timed; one in 20 has histograms


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
    with logger(work) as log:
        samples = [generation_split(work, population, log) for _ in range(repeats + 1)][1:]
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


@contextmanager
def logger(work: Workload) -> Iterator[TensorBoardWatch]:
    """A run's TensorBoard files, in a folder that goes again."""
    with (
        tempfile.TemporaryDirectory() as folder,
        TensorBoardWatch(folder, {}, actions=work.actions) as log,
    ):
        yield log


def generation_split(
    work: Workload, population: Population, log: TensorBoardWatch
) -> dict[str, float]:
    """Seconds of each of `PARTS` in one generation that begins with this population."""
    watch, generator = Stopwatch(), torch.Generator().manual_seed(6)
    select = watch.around("selection", EvolutionSettings().selection)
    settings = EvolutionSettings(population=len(population), selection=select)
    keep = torch.zeros(work.environment.num_scenarios, dtype=torch.bool)
    with watch.running("rollouts"):
        result = evaluate(population.graphs, work.actions, work.environment, keep)
    rollouts = watch.taken()["rollouts"]
    with watch.running("operators"):
        best = int(ranking(result.fitness, population.graphs.num_nodes)[0])
        state = EvolutionState(population, 0, population[:1], 0.0)
        tell(state, result.fitness, settings, work.actions, generator, result.scores)
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
    inside = {
        name: share * rollouts for name, share in rollout_shares(work, population, keep).items()
    }
    return inside | {
        "rest of rollouts": rollouts - sum(inside.values()),
        "selection": after["selection"],
        "operators": after["operators"] - after["selection"],
        "logging": logged,
    }


def rollout_shares(work: Workload, population: Population, keep: Tensor) -> dict[str, float]:
    """What share of the evaluation of a population Γ, C, networks and checks of motions take.

    Compiled code counts the ticks of the CPU's clock around each of them, on one thread. Counting
    takes time itself, some hundredths, which go to the rest.
    """
    program = compile_graphs(population.graphs, work.actions)
    ticks, ends = torch.zeros(4, dtype=torch.long), torch.zeros(2, dtype=torch.long)
    clock = function("rollout", "clock_now", torch.float32, POINTER)
    assert clock is not None, "this line measures compiled code; install a C compiler"  # noqa: S101
    clock(ends[:1].data_ptr())
    compiled_evaluation(program, work.environment, keep, MAX_TRANSITIONS, MAX_STEPS, ticks)
    clock(ends[1:].data_ptr())
    whole = int(ends[1] - ends[0])
    return dict(zip(INSIDE, (ticks / whole).tolist(), strict=True))
