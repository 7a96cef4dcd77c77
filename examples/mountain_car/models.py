"""Γ and C: kernel machines of the library on the car's percepts, and how they learn on."""

from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Generator, Tensor

from cgtorch.environment import Dataset
from cgtorch.environment import Environment
from cgtorch.errors import ModelError
from cgtorch.runs.storage import load_dataset, save_dataset
from cgtorch.svm import (
    SVC,
    SVR,
    reduced_set as compact,
    grid_search,
    load_model,
    load_model_and_report,
    save_model,
)
from cgtorch.simulation import ModelEnvironment

SEEN = 2  # of the percept: what was spent does not change how the car rolls
MOST_NOVEL, FAMILIAR = 0.75, 0.999
LOOKS = 16  # pushes for which errors of Γ are drawn; later ones use them again
CENTRES = 128
MOST_NEW = 200  # transitions, and labels, that are learned from one experience


@dataclass(frozen=True)
class Cell:
    """The cell of a grid that cross-validation chose.

    Attributes:
        cost: C, one for each output.
        width: gamma.
        tube: epsilon, one for each output; () for the classifier.
        score: R² or balanced accuracy, the mean over outputs.
    """

    cost: tuple[float, ...]
    width: float
    tube: tuple[float, ...]
    score: float


@dataclass(frozen=True)
class CarModels:
    """Γ and C, and what they were learned from.

    Attributes:
        data: transitions and labels.
        gamma: from position, speed and force to what a push changes of the three percepts, all
            divided by `scale`; it has few centres, as it is asked often.
        classifier: from percepts divided by their `spread` to whether the car has succeeded.
        scale: (6,) standard deviations of position, speed, force and the three changes.
        spread: (3,) standard deviations of percepts.
        reach: squared distance from all centres of Γ that counts as half novel.
        cells: what was chosen for Γ and for C.
    """

    data: Dataset
    gamma: SVR
    classifier: SVC
    scale: Tensor
    spread: Tensor
    reach: float
    cells: tuple[Cell, Cell]

    def predict(self, percept: Tensor, force: Tensor) -> tuple[Tensor, Tensor]:
        """Γ: percepts (n, 3) after forces (n, 1), and how novel (n,) that is, from 0 to 1."""
        change, distance = self.gamma.values_and_distance(_inputs(percept, force, self.scale))
        after = percept + (change * self.scale[3:6]).to(percept)
        return after, (1 - torch.exp2(-distance / self.reach)).to(percept)

    def success(self, percept: Tensor) -> Tensor:
        """C: the probability (n,) that the car has succeeded."""
        return self.classifier(percept / self.spread).to(percept)


def _inputs(percept: Tensor, force: Tensor, scale: Tensor) -> Tensor:
    return torch.cat([percept[:, :SEEN], force], 1) / scale[: SEEN + 1]


def fit_models(data: Dataset, seed: int) -> CarModels:
    """Γ and C with the hyper-parameters that cross-validation chooses on 400 rows."""
    change = data.next_percept - data.percept
    scale = torch.cat([data.percept[:, :SEEN], data.motion, change], 1).double().std(0)
    spread = data.grasp_percept.double().std(0)
    x, y = _inputs(data.percept, data.motion, scale), change / scale[3:6]
    found = grid_search(
        SVR(), x[:400], y[:400], C=(30, 300), gamma=(0.1, 0.3), epsilon=(0.01,), seed=seed
    )
    costs, tubes, scores = zip(*((c.C, c.epsilon, c.score) for c in found.common), strict=True)
    gamma = Cell(costs, found.common[0].gamma, tubes, sum(scores) / len(scores))
    found = grid_search(
        SVC(),
        data.grasp_percept[:400] / spread,
        data.graspable[:400],
        C=(10, 100, 1000),
        gamma=(0.3, 1.0),
        seed=seed,
        scoring="balanced_accuracy",
    )
    best = found.best[0]
    return _fitted(data, scale, spread, (gamma, Cell((best.C,), best.gamma, (), best.score)), seed)


def _fitted(
    data: Dataset, scale: Tensor, spread: Tensor, cells: tuple[Cell, Cell], seed: int
) -> CarModels:
    """Both machines with given hyper-parameters, on all data."""
    x = _inputs(data.percept, data.motion, scale)
    y = (data.next_percept - data.percept) / scale[3:6]
    cell, other = cells
    gamma = SVR(cell.cost, gamma=cell.width, epsilon=cell.tube, seed=seed).fit(x, y)
    gamma = compact(gamma, CENTRES, x)[0]
    classifier = SVC(other.cost[0], gamma=other.width, probability=True, seed=seed)
    classifier.fit(data.grasp_percept / spread, data.graspable)
    distance = gamma.values_and_distance(x)[1]
    reach = float(distance.quantile(FAMILIAR).clamp_min(1e-3))
    return CarModels(data, gamma, classifier, scale, spread, reach, cells)


def imagine(
    models: CarModels,
    percepts: Tensor,
    replicas: int,
    generator: Generator,
    device: torch.device | str = "cpu",
) -> Environment:
    """See `cgtorch.improvement.interfaces.Imagine`: Γ errs as it does on what it was trained on."""
    data = models.data
    with torch.no_grad():
        residual = data.next_percept - models.predict(data.percept, data.motion)[0]
    percepts = percepts.repeat_interleave(replicas, 0)
    rows = torch.randint(len(residual), (len(percepts), LOOKS), generator=generator)
    return ModelEnvironment(
        percepts,
        models.predict,
        models.success,
        lambda percept, force: force[:, 0].abs() <= 1,
        control_size=1,
        errors=residual[rows],
        most_novel=MOST_NOVEL,
    )


def learn(models: CarModels, experience: Dataset, generator: Generator) -> CarModels:
    """See `cgtorch.improvement.interfaces.Learn`: the same machines, on some of what is new besides."""
    moves = torch.randperm(len(experience.percept), generator=generator)[:MOST_NEW]
    tests = torch.randperm(len(experience.graspable), generator=generator)[:MOST_NEW]
    new = Dataset(
        experience.percept[moves],
        experience.motion[moves],
        experience.next_percept[moves],
        experience.grasp_percept[tests],
        experience.graspable[tests],
    )
    return _fitted(models.data.extended(new), models.scale, models.spread, models.cells, 0)


def save_models(folder: Path, models: CarModels) -> None:
    """Write the models and their data into a folder."""
    notes = {
        "scale": models.scale.tolist(),
        "spread": models.spread.tolist(),
        "reach": models.reach,
        "cells": [asdict(cell) for cell in models.cells],
    }
    save_model(folder / "gamma.safetensors", models.gamma, notes)
    save_model(folder / "classifier.safetensors", models.classifier)
    save_dataset(folder / "data.safetensors", models.data, {})


def load_models(folder: Path) -> CarModels:
    """Read what `save_models` wrote; ModelError or RunError if it is damaged."""
    gamma, notes = load_model_and_report(folder / "gamma.safetensors")
    classifier = load_model(folder / "classifier.safetensors")
    if not isinstance(gamma, SVR) or not isinstance(classifier, SVC):
        raise ModelError(f"{str(folder)!r} does not hold an SVR and an SVC; restore its files")
    first, second = (
        Cell(tuple(c["cost"]), c["width"], tuple(c["tube"]), c["score"]) for c in notes["cells"]
    )
    scale, spread = (torch.tensor(notes[name], dtype=torch.float64) for name in ("scale", "spread"))
    data = load_dataset(folder / "data.safetensors")
    return CarModels(data, gamma, classifier, scale, spread, notes["reach"], (first, second))
