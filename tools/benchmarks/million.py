"""The memory that the first generations of a million individuals take."""

import itertools
import time

import torch

from benchmarks.growth import peak_memory
from benchmarks.measure import Comparison, Effort, Line, cores, run_threads, timing
from benchmarks.workload import workload
from cgtorch.evolution import EvolutionSettings, evolve

MILLION = 1_000_000
GENERATIONS = 4


def memory_of_a_million(effort: Effort) -> Line:
    """Peak memory of whole generations, from the first random graphs on."""
    work, settings = workload(), EvolutionSettings(population=MILLION)

    def search() -> None:
        generator = torch.Generator().manual_seed(2)
        found = evolve(work.environment, work.actions, settings, generator)
        for _ in itertools.islice(found, GENERATIONS):
            pass

    with run_threads(cores()):
        begin = time.perf_counter()
        gigabytes = peak_memory(search) / 1024
        seconds = timing([time.perf_counter() - begin])
    part = Comparison(
        label=f"{MILLION} x {work.environment.num_scenarios}, {GENERATIONS} generations",
        ours=seconds,
        other=seconds,
        ratio=gigabytes,
        difference=None,
    )
    compared = "GiB by which the first generations of a search raise this process's memory at most"
    return Line("memory_of_a_million", compared, "GiB", 8.0, "wall", cores(), (part,), at_most=True)
