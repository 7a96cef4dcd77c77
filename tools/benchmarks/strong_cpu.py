"""Rollouts with the usual means of CPUs: NumPy over scenarios, one individual per process.

Scikit-learn predicts all rows of a step at once, finished lanes leave, and each process gets its
share of the individuals in a few large pieces. It lacks batches across individuals, which a struct
of tensors allows.
"""

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.pool import Pool

import numpy as np
from numpy.typing import NDArray

from benchmarks.array_models import ArrayModels, sigmoid
from benchmarks.plain_models import Array, PlainModels
from cgtorch.graphs import NO_NODE, ActionSet, Graphs

Integers = NDArray[np.int64]
Results = tuple[Array, Array, Array]

NAMES = ("MoveBase", "Detect", "Grasp", "ContinuousNN", "BranchingNN")
MOVE, _, GRASP, CONTINUOUS, BRANCHING = range(len(NAMES))
HIDDEN = 3
PIECES = 4  # for each process, so that none waits long for the last


@dataclass(frozen=True)
class ArrayGraphs:
    """P individuals: kinds (P, N) into `NAMES`, heads (P, N, 2), parameters (P, N, K), start."""

    kind: Integers
    heads: Integers
    parameters: Array
    start: Integers

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, index: slice) -> "ArrayGraphs":
        return ArrayGraphs(
            self.kind[index], self.heads[index], self.parameters[index], self.start[index]
        )


def array_graphs(graphs: Graphs, actions: ActionSet) -> ArrayGraphs:
    """The individuals as arrays."""
    order = np.array([NAMES.index(name) for name in actions.names])
    kind = order[graphs.action.clamp_min(0).numpy()]
    parameters = graphs.parameters.double().numpy()
    return ArrayGraphs(kind, graphs.edges.numpy(), parameters, graphs.start.numpy())


def run_individual(
    models: ArrayModels, graphs: ArrayGraphs, i: int, max_transitions: int
) -> Results:
    """Success (B,), last percepts (B, 7) and transitions (B,) of one individual."""
    percept, errors = models.models.percepts.copy(), models.models.errors
    kinds, heads, parameters = graphs.kind[i], graphs.heads[i], graphs.parameters[i]
    b = len(percept)
    message, motions = np.full((b, 3), np.nan), np.zeros(b, dtype=np.int64)
    lost, succeeded = np.zeros(b, dtype=bool), np.zeros(b, dtype=bool)
    transitions = np.full(b, max_transitions)
    lane, node = np.arange(b), np.full(b, graphs.start[i])
    for step in range(1, max_transitions + 1):
        kind, outcome = kinds[node], np.zeros(len(lane), dtype=np.int64)
        for k in set(kind.tolist()):
            (where,) = (kind == k).nonzero()
            rows = lane[where]
            if k == MOVE:
                outcome[where] = 1
                asked = np.isfinite(message[rows]).all(1) & ~lost[rows]
                where, rows = where[asked], rows[asked]
                free = models.possible(percept[rows], message[rows])
                where, rows = where[free], rows[free]
                if len(rows):
                    next_percept, novelty = models.gamma(percept[rows], message[rows])
                    turn = motions[rows] % errors.shape[1]
                    percept[rows] = next_percept + errors[rows, turn]
                    motions[rows] += 1
                    lost[rows] = novelty > models.models.most_novel
                    outcome[where] = 0
            elif k == GRASP:
                outcome[where] = lost[rows] | (models.success(percept[rows]) <= 0.5)
            elif k == CONTINUOUS:
                message[rows] = network(percept[rows], parameters[node[where]], 3)
            elif k == BRANCHING:
                out = sigmoid(network(percept[rows], parameters[node[where]], 2))
                outcome[where] = out[:, 1] > out[:, 0]
        node = heads[node, outcome]
        done = node == NO_NODE
        if done.any():
            succeeded[lane[done]], transitions[lane[done]] = True, step
            lane, node = lane[~done], node[~done]
            if not len(lane):
                break
    return succeeded, percept, transitions


def network(x: Array, weights: Array, outputs: int) -> Array:
    """(n, outputs) of networks of one hidden layer, each row (n, 7) with its own (n, K) weights."""
    n, inputs = x.shape
    sizes = np.cumsum([HIDDEN * inputs, HIDDEN, outputs * HIDDEN, outputs])
    w1, b1, w2, b2, _ = np.split(weights, sizes, axis=1)
    hidden = sigmoid((w1.reshape(n, HIDDEN, inputs) @ x[:, :, None])[..., 0] + b1)
    return (w2.reshape(n, outputs, HIDDEN) @ hidden[:, :, None])[..., 0] + b2


def run_share(models: ArrayModels, max_transitions: int, graphs: ArrayGraphs) -> Results:
    """The same for all individuals of a share, stacked."""
    runs = [run_individual(models, graphs, i, max_transitions) for i in range(len(graphs))]
    succeeded, percept, transitions = (np.stack(part) for part in zip(*runs, strict=True))
    return succeeded, percept, transitions


@contextmanager
def processes(models: PlainModels, count: int) -> Iterator[Pool]:
    """So many processes that hold the models, started afresh: forking would copy held locks."""
    with multiprocessing.get_context("spawn").Pool(count, _begin, (models,)) as pool:
        # Not before each process has answered is it sure that none is still starting.
        pool.map(_waits, range(count), chunksize=1)
        yield pool


def run_all(pool: Pool, count: int, graphs: ArrayGraphs, max_transitions: int) -> Results:
    """Success (P, B), last percepts (P, B, 7) and transitions (P, B), on `count` processes."""
    size = -(-len(graphs) // (count * PIECES))
    pieces = [graphs[k : k + size] for k in range(0, len(graphs), size)]
    shares = pool.map(partial(_run, max_transitions), pieces, chunksize=1)
    succeeded, percept, transitions = (np.concatenate(part) for part in zip(*shares, strict=True))
    return succeeded, percept, transitions


_models: list[ArrayModels] = []  # of this process, once it has begun


def _begin(models: PlainModels) -> None:
    _models.append(ArrayModels(models))


def _waits(_: int) -> None:
    import time

    time.sleep(0.2)


def _run(max_transitions: int, graphs: ArrayGraphs) -> Results:
    return run_share(_models[0], max_transitions, graphs)
