"""One generation of evolution, split into what it is made of."""

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import torch
from torch import Tensor

from benchmarks.measure import Comparison, Effort, Line, cores, run_threads, timing
from benchmarks.stopwatch import Stopwatch
from benchmarks.workload import Workload, populations, workload
from cgtorch.evolution import EvolutionSettings, Generation, Island, Population
from cgtorch.evolution.evolution import EvolutionState, tell
from cgtorch.evolution.fitness import evaluator
from cgtorch.evolution.selection import ranking
from cgtorch.improvement.events import GenerationDone
from cgtorch.native import function
from cgtorch.native.structures import POINTER, WHOLE
from cgtorch.report.tensorboard import TensorBoardWatch
from cgtorch.simulation import MAX_STEPS, MAX_TRANSITIONS
from cgtorch.simulation.compiled import compiled_evaluation
from cgtorch.simulation.interpreter import interpreter

MODELS = ("Γ", "C", "networks")
"""What a generation is for; the rest is overhead."""
INSIDE = (*MODELS, "possible motions")
"""What compiled code counts the ticks of, in the order of rollout.c."""
PARTS = (*INSIDE, "rest of rollouts", "selection", "operators", "logging")
READINGS = 100_000
"""Of the clock with nothing in between."""
LOGGED = 20  # generations that are logged for each that is timed; one in 20 has histograms


def overhead_share(effort: Effort) -> Line:
    """What part of a generation is neither Γ, C nor the networks."""
    work = workload()
    with run_threads(cores()):
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
    evaluation = evaluator(work.actions, work.environment, keep)  # one for a whole evolution
    with watch.running("rollouts"):
        result = evaluation(population.graphs)
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
    inside = dict(zip(INSIDE, rollout_parts(work, population), strict=True))
    return inside | {
        "rest of rollouts": rollouts - sum(inside.values()),
        "selection": after["selection"],
        "operators": after["operators"] - after["selection"],
        "logging": logged,
    }


def rollout_parts(work: Workload, population: Population) -> list[float]:
    """Seconds that Γ, C, networks and checks of motions take of an evaluation on all cores.

    Compiled code counts the ticks of the CPU's clock around each of them, on one thread. What it
    reads where there is nothing to time is what reading takes, and does not count. These parts are
    compared with the time of the same call that counts nothing, on one thread and on all, less what
    it takes for no graphs: all of the time outside of the compiled loops is overhead.
    """
    graphs, none = population.graphs, population.graphs[:0]
    known = interpreter(work.actions, work.environment)
    assert known is not None, "this line measures compiled code; install a C compiler"  # noqa: S101
    call = partial(
        compiled_evaluation,
        known,
        scenarios=torch.arange(work.environment.num_scenarios),
        kept=0,
        max_transitions=MAX_TRANSITIONS,
        max_steps=MAX_STEPS,
    )
    ticks, nothing, ends = (torch.zeros(2, size, dtype=torch.long) for size in (4, 4, 1))
    # The least of several: one that was interrupted is longer than what it is taken from.
    empty = min(_seconds(lambda: call(none)) for _ in range(5))
    together = _seconds(lambda: call(graphs)) - empty
    with run_threads(1):
        _clock("clock_now", ends[0])
        begin = time.perf_counter()
        alone = _seconds(lambda: call(graphs))
        lapse = time.perf_counter() - begin
        _clock("clock_now", ends[1])
        call(graphs, ticks=ticks)
        _clock("clock_alone", nothing, READINGS)
    reading = nothing[0].sum() / nothing[1].sum()
    inside = (ticks[0] - reading * ticks[1]) * (lapse / float(ends[1] - ends[0]))
    return (inside * together / (alone - empty)).tolist()


def _seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def _clock(name: str, ticks: Tensor, *times: int) -> None:
    """Let compiled code read its clock."""
    clock = function(name, torch.float32, POINTER, *[WHOLE] * len(times))
    assert clock is not None, "this line measures compiled code; install a C compiler"  # noqa: S101
    clock(ticks.data_ptr(), *times)
