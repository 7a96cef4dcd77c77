"""Grid search by cross-validation against scikit-learn's GridSearchCV, all cores for both."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.measure import (
    WALL,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    cores,
    in_turns,
    torch_threads,
)
from cgtorch.ground.environment import Dataset
from cgtorch.svm import SVC, SVR, grid_search
from cgtorch.tabletop.data import Scenes, collect
from cgtorch.tabletop.domain import Tabletop

Array = NDArray[np.float64]

COSTS = [2.0**k for k in (-1, 1, 3, 5, 7, 9)]
WIDTHS = [2.0**k for k in (-9, -7, -5, -3, -1, 1)]
FOLDS = 5
TUBE = 0.02
LONG = 2500  # rows times outputs above which a search is timed once
CLOSE = 0.02  # how much two scores of a cell may differ where libsvm stops at its tolerance 1e-3


@dataclass(frozen=True)
class Case:
    """A grid search: rows (n, d), targets (n, k) or labels (n,), and whether it is a regression."""

    label: str
    x: Array
    y: Array
    regression: bool
    costs: tuple[float, ...] = tuple(COSTS)


def svc_grid_search(effort: Effort) -> Line:
    """C's labels: five folds, six costs, six widths."""
    sizes = (300, 500, 1000, 2000) if effort.size == 1 else (300,)
    return _line("svc_grid_search", [_labels(n) for n in sizes], 4.0)


def svr_grid_search(effort: Effort) -> Line:
    """Γ's transitions as the paper learns them: seven outputs, five folds, six costs and widths.

    A quarter of an hour in full, nearly all of it scikit-learn's.
    """
    sizes = (300, 500, 2000) if effort.size == 1 else (100,)
    return _line("svr_grid_search", [_transitions(n) for n in sizes], 10.0)


def svc_grid_search_large(_: Effort) -> Line:
    """The same with 10,000 labels: minutes, most of them scikit-learn's."""
    return _line("svc_grid_search_large", [_labels(10_000)], 2.0)


def svr_grid_search_large(_: Effort) -> Line:
    """One output of 10,000 transitions at the three smaller costs; the others take hours there."""
    case = _transitions(10_000)
    label = f"{len(case.x)} rows, 1 output, C to {COSTS[2]:g}"
    less = replace(case, label=label, y=case.y[:, :1], costs=tuple(COSTS[:3]))
    return _line("svr_grid_search_large", [less], 2.0)


def _line(name: str, cases: list[Case], target: float) -> Line:
    with torch_threads(cores()):
        parts = tuple(_against_sklearn(case) for case in cases)
    return Line(
        name=name,
        compared=f"grid_search / GridSearchCV, {FOLDS} folds x {len(cases[0].costs)} C x 6 gamma",
        unit="x faster",
        target=target,
        clock="wall",
        threads=cores(),
        parts=parts,
    )


def _labels(rows: int) -> Case:
    data = _collected(16, rows + 16)
    x = data.tested.double().numpy()[:rows]
    return Case(f"{rows} rows", _scaled(x), data.succeeded.numpy()[:rows], regression=False)


def _transitions(rows: int) -> Case:
    data = _collected(rows, 64)
    p, u, q = (t.double().numpy() for t in (data.percept, data.control, data.next_percept))
    x = np.concatenate([p, u[:, :2], np.sin(u[:, 2:]), np.cos(u[:, 2:])], 1)
    return Case(f"{rows} rows, 7 outputs", _scaled(x), _scaled(q), regression=True)


def _collected(transitions: int, labels: int) -> Dataset:
    generator = torch.Generator().manual_seed(0)
    return collect(Scenes(Tabletop().world), transitions, labels, generator)


def _scaled(x: Array) -> Array:
    spread = x.std(0)
    return np.asarray((x - x.mean(0)) / np.where(spread > 0, spread, 1))


def _against_sklearn(case: Case) -> Comparison:
    """One case, timed five times, or once and without a first call where that takes minutes."""
    outputs = case.y.shape[1] if case.regression else 1
    repeats, warm_up = (5, 1) if len(case.x) * outputs <= LONG else (1, 0)
    works = _ours(case), _theirs(case)
    scores: tuple[list[Array], list[Array]] = ([], [])
    mine, other = in_turns(
        [partial(_kept, *pair) for pair in zip(works, scores, strict=True)],
        repeats,
        WALL,
        warm_up=warm_up,
    )
    worst = float(np.abs(scores[0][-1] - scores[1][-1]).max())
    if worst > CLOSE:
        raise DisagreementError(f"{case.label}: two scores of a cell differ by {worst:.3g}")
    return Comparison(
        label=case.label,
        ours=mine,
        other=other,
        ratio=other.median / mine.median,
        difference=worst,
        sizes={"rows": len(case.x), "problems": FOLDS * 6 * len(case.costs) * outputs},
    )


def _kept(work: Callable[[], Array], results: list[Array]) -> None:
    results.append(work())


def _folds(case: Case) -> NDArray[np.int64]:
    return np.random.default_rng(0).permutation(len(case.x)) % FOLDS


def _ours(case: Case) -> Callable[[], Array]:
    model = SVR(epsilon=TUBE) if case.regression else SVC()

    def search() -> Array:
        found = grid_search(model, case.x, case.y, C=case.costs, gamma=WIDTHS, folds=_folds(case))
        return np.asarray(found.mean[:, 0].numpy())

    return search


def _theirs(case: Case) -> Callable[[], Array]:
    from sklearn import svm
    from sklearn.model_selection import GridSearchCV, PredefinedSplit

    model = svm.SVR(epsilon=TUBE) if case.regression else svm.SVC()
    grid, split = {"gamma": WIDTHS, "C": case.costs}, PredefinedSplit(_folds(case))

    def search() -> Array:
        scores = []
        for target in case.y.T if case.regression else [case.y]:
            found = GridSearchCV(model, grid, cv=split, n_jobs=cores(), refit=False)
            scores.append(found.fit(case.x, target).cv_results_["mean_test_score"])
        return np.stack(scores, -1).reshape(len(case.costs), len(WIDTHS), -1).transpose(1, 0, 2)

    return search
