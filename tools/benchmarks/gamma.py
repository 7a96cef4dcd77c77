"""The fitted Γ, beside the machine's ceiling for its kernel evaluation."""

import copy
from functools import partial

import torch

from benchmarks.ceiling import Shape, against_ceiling
from benchmarks.measure import Comparison, Effort, Line, cores, difference, torch_threads
from benchmarks.workload import workload
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.transition import TransitionModel


def gamma_ceiling(effort: Effort) -> Line:
    """Rows per second of Γ, geometry and novelty included, and of its machine alone."""
    knowledge, rows, count = workload().knowledge, int(65_536 * effort.size), cores()
    models = {"Γ of searches": knowledge.swift, "Γ as fitted": knowledge.gamma}
    with torch_threads(count):
        parts = tuple(
            _compared(f"{name}, {part}", model, knowledge, rows, effort.repeats, count, part)
            for name, model in models.items()
            for part in ("whole", "machine")
        )
    return Line(
        name="gamma_ceiling",
        compared=(
            "percepts and novelty that Γ predicts, or its machine's values and distances / GEMM "
            "rows x inputs x centres, exp2 in cache and GEMM rows x centres x outputs, each alone, "
            "best chunks and threads, added"
        ),
        unit="of the ceiling",
        target=0.7,
        clock="wall",
        threads=count,
        parts=parts,
    )


def _compared(
    label: str,
    model: TransitionModel,
    knowledge: Knowledge,
    rows: int,
    repeats: int,
    count: int,
    part: str,
) -> Comparison:
    """The whole of Γ, or the machine in it, on transitions that were collected."""
    data, machine = knowledge.dataset, model.machine
    pick = torch.randint(len(data.percept), (rows,), generator=torch.Generator().manual_seed(8))
    percept, motion = data.percept[pick], data.control[pick]
    with torch.no_grad():
        exact = copy.deepcopy(model).double()
        if part == "whole":
            work = partial(model.predict_with_novelty, percept, motion)
            truth = exact.predict_with_novelty(percept.double(), motion.double())
        else:
            features = model.features(percept, motion)
            work = partial(machine.values_and_distance, features)
            truth = exact.machine.values_and_distance(features.double())
        gap = difference(work()[0], truth[0], most=1e-3)
    centres, inputs = machine.centres.shape
    shape = Shape(rows, inputs, centres, len(machine.bias))
    return against_ceiling(f"{label}, {centres} centres", work, shape, gap, repeats, count)
