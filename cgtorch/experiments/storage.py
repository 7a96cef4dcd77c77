"""Datasets, scenarios, populations and results as files: safetensors and JSON, never code."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import safetensors.torch
import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.data import Dataset
from cgtorch.errors import GraphError, RunError
from cgtorch.evolution import Population, population_from
from cgtorch.files import read_bytes, read_json, write_bytes, write_json
from cgtorch.graphs import Graphs
from cgtorch.improvement.knowledge import Knowledge, swift_gamma
from cgtorch.models import (
    Choice,
    LearningCurve,
    SuccessClassifier,
    SuccessReport,
    TransitionModel,
    TransitionReport,
    load_model_and_report,
    save_model,
)
from cgtorch.models.storage import tensors_of
from cgtorch.world import Scenarios

GAMMA, CLASSIFIER = "gamma.safetensors", "classifier.safetensors"
MAX_BYTES = 2**30
T = TypeVar("T", Dataset, Graphs)


def save_tensors(path: Path, tensors: dict[str, Tensor], notes: dict[str, str]) -> None:
    """Write named tensors with notes, whole or not at all."""
    plain = {name: t.detach().cpu().contiguous() for name, t in tensors.items()}
    write_bytes(path, safetensors.torch.save(plain, metadata=notes))


def load_tensors(path: Path, names: set[str]) -> dict[str, Tensor]:
    """Read named tensors.

    Raises:
        RunError: the file is missing, damaged, too large, or holds other tensors.
    """
    data = read_bytes(path, MAX_BYTES)
    try:
        found = tensors_of(data)
    except ValueError as e:
        raise RunError(f"cannot read {str(path)!r} ({e}); restore the file") from e
    if set(found) != names:
        odd = sorted(names ^ set(found))[0]
        raise RunError(f"{str(path)!r} lacks or has tensor {odd!r}; is it of this version?")
    return found


def save_dataset(path: Path, dataset: Dataset, notes: dict[str, str]) -> None:
    """Write a dataset with notes on how it was collected."""
    save_tensors(path, vars(dataset), notes)


def load_dataset(path: Path) -> Dataset:
    """Read a dataset; RunError if its tensors do not fit one another or are not finite."""
    data = Dataset(**load_tensors(path, {f.name for f in fields(Dataset)}))
    if not data.whole():
        raise RunError(
            f"the tensors of {str(path)!r} do not fit one another or are not finite; restore the "
            "file"
        )
    return data


def holds_models(folder: Path) -> bool:
    """Whether a folder of a run has Γ or C: a run may be passed on without them."""
    return any((folder / name).exists() for name in (GAMMA, CLASSIFIER))


def save_knowledge(folder: Path, knowledge: Knowledge, notes: dict[str, str]) -> None:
    """Write data, Γ and C into a folder."""
    save_dataset(folder / "data.safetensors", knowledge.dataset, notes)
    said = [] if knowledge.verdicts is None else [v.reason for v in knowledge.verdicts]
    learned = dict(zip(("learned_gamma", "learned_classifier"), said, strict=False))
    save_dataset(folder / "aside.safetensors", knowledge.aside, {**notes, **learned})
    save_model(folder / GAMMA, knowledge.gamma, knowledge.gamma_report)
    save_model(folder / CLASSIFIER, knowledge.classifier, knowledge.classifier_report)


@dataclass(frozen=True)
class Models:
    """Γ and C with what their fits found."""

    gamma: TransitionModel
    classifier: SuccessClassifier
    gamma_report: TransitionReport
    classifier_report: SuccessReport


def load_knowledge(folder: Path) -> Knowledge:
    """Read what `save_knowledge` wrote.

    Raises:
        RunError: a file holds another kind of model, or a report that is none.
        ModelError: a model file is damaged.
    """
    models = load_models(folder)
    data = load_dataset(folder / "data.safetensors")
    aside = load_dataset(folder / "aside.safetensors")
    swift = swift_gamma(models.gamma, data)
    return Knowledge(
        data, models.gamma, swift, models.classifier, models.gamma_report,
        models.classifier_report, aside,
    )  # fmt: skip


def load_models(folder: Path) -> Models:
    """Γ and C of what `save_knowledge` wrote, without the data; errors are those."""
    gamma, first_report = load_model_and_report(folder / GAMMA)
    classifier, second_report = load_model_and_report(folder / CLASSIFIER)
    if not isinstance(gamma, TransitionModel) or not isinstance(classifier, SuccessClassifier):
        raise RunError(f"{str(folder)!r} holds other models than Γ and C; restore the files")
    try:
        choices = tuple(None if c is None else Choice(**c) for c in first_report["choice"])
        gamma_report = TransitionReport(**{**_fields(first_report), "choice": choices})
        choice = Choice(**second_report["choice"])
        report = SuccessReport(**{**_fields(second_report), "choice": choice})
    except (TypeError, KeyError, RecursionError) as e:
        raise RunError(f"the reports of the models in {str(folder)!r} are damaged ({e})") from e
    return Models(gamma, classifier, gamma_report, report)


def _fields(report: dict[str, Any]) -> dict[str, Any]:
    """The fields of a report: JSON's lists as tuples, and the learning curve, if it has one."""
    found = {name: _frozen(value) for name, value in report.items()}
    if found.get("learning_curve") is not None:
        found["learning_curve"] = LearningCurve(**found["learning_curve"])
    return found


def _frozen(value: Any) -> Any:
    """JSON's lists as the tuples they were, at any depth."""
    if isinstance(value, dict):
        return {name: _frozen(one) for name, one in value.items()}
    return tuple(_frozen(one) for one in value) if isinstance(value, list) else value


def save_population(path: Path, population: Population) -> None:
    """Write graphs and strategies."""
    save_tensors(path, {**vars(population.graphs), "strategy": population.strategy}, {})


def load_population(path: Path, actions: ActionSet) -> Population:
    """Read graphs and strategies.

    Args:
        path: the file.
        actions: what the graphs' nodes can be.

    Raises:
        RunError: the file is damaged, or holds graphs that are not valid.
    """
    names = {f.name for f in fields(Graphs)} | {"strategy"}
    try:
        return population_from(load_tensors(path, names), actions)
    except GraphError as e:
        raise RunError(f"{str(path)!r} does not hold valid graphs; restore the file") from e


_WORDS = ("stage", "edge")
_COUNTS = (
    "targets_succeeded", "targets", "earlier_failures", "earlier_failures_succeeded", "w_size",
    "w_lost", "nodes", "depth", "generations", "transitions",
)  # fmt: skip
_SCORES = ("fresh", "perimeter")


def load_result(path: Path) -> dict[str, Any]:
    """Read a stage's result.json; RunError if it lacks a number of the final table."""
    data = read_json(path)
    if not isinstance(data, dict):
        raise RunError(f"{str(path)!r} is no result of a stage; restore the file")
    scores = {name: data.get(name) for name in _SCORES}
    seconds: Any = data.get("seconds")
    right = {
        **{name: isinstance(data.get(name), str) for name in _WORDS},
        **{name: _is_count(data.get(name)) for name in _COUNTS},
        **{name: _is_score(score) for name, score in scores.items()},
        "decisive": data.get("decisive") is None or _is_score(data["decisive"]),
        "seconds": type(seconds) in (int, float) and 0 <= seconds < 1e12,
    }
    for name, ok in right.items():
        if not ok:
            raise RunError(f"{name} of {str(path)!r} is {data.get(name)!r:.40}; restore the file")
    return data


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**53


def _is_score(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and isinstance(value.get("placement"), str)
        and _is_count(value.get("tried"))
        and _is_count(value.get("succeeded"))
        and value["succeeded"] <= value["tried"]
    )


SIZES = {"pose": 3, "table": 6, "object": 2}


def scenarios_to_list(scenarios: Scenarios) -> list[dict[str, Any]]:
    """One plain object per scenario, with "obstacles" only if any of them may have some."""
    parts = {name: value.tolist() for name, value in vars(scenarios).items() if value[:1].numel()}
    return [{name: rows[i] for name, rows in parts.items()} for i in range(len(scenarios))]


def scenarios_from_list(data: Any, where: str) -> Scenarios:
    """Scenarios from what `scenarios_to_list` gave.

    Raises:
        RunError: an entry lacks a key, or its numbers are not of the right kind and count.
    """
    if not isinstance(data, list):
        raise RunError(f"{where} is {data!r:.40}; give a list of scenarios")
    for i, row in enumerate(data):
        _check_scenario(row, f"scenario {i} of {where}")
    if len(counts := {len(row.get("obstacles", ())) for row in data}) > 1:
        raise RunError(f"{where} is of scenarios with {sorted(counts)} obstacles; give all as many")
    parts = {name: _numbers([row[name] for row in data], size) for name, size in SIZES.items()}
    seed = torch.tensor([row["seed"] for row in data], dtype=torch.long)
    boxes = _numbers([row.get("obstacles", []) for row in data], max(counts, default=0), 5)
    return Scenarios(**parts, seed=seed, obstacles=boxes)


def _numbers(rows: list[Any], *sizes: int) -> Tensor:
    return torch.tensor(rows, dtype=torch.float32).view(len(rows), *sizes)


def _check_scenario(row: Any, where: str) -> None:
    if not isinstance(row, dict) or set(row) - {"obstacles"} != {*SIZES, "seed"}:
        raise RunError(f"{where} is {row!r:.60}; give pose, table, object and seed")
    for name, size in SIZES.items():
        _check_numbers(row[name], size, f"{name} of {where}")
    boxes = row.get("obstacles", [])
    if not isinstance(boxes, list):
        raise RunError(f"obstacles of {where} is {boxes!r:.60}; give a list")
    for box in boxes:
        _check_numbers(box, 5, f"an obstacle of {where}")
    if type(row["seed"]) is not int or not 0 <= row["seed"] < 2**63:
        raise RunError(f"seed of {where} is {row['seed']!r:.40}; give a whole number")


def _check_numbers(values: Any, size: int, what: str) -> None:
    if (
        not isinstance(values, list)
        or len(values) != size
        or not all(type(v) in (int, float) and abs(v) < 1e6 for v in values)
    ):
        raise RunError(f"{what} is {values!r:.60}; give {size} finite numbers")


def save_scenarios(path: Path, parts: dict[str, Scenarios]) -> None:
    """Write named batches of scenarios, such as W and M."""
    write_json(path, {name: scenarios_to_list(s) for name, s in parts.items()})


def load_scenarios(path: Path, names: tuple[str, ...]) -> tuple[Scenarios, ...]:
    """Read the batches called `names`; RunError if one is missing or damaged."""
    data = read_json(path)
    for name in names:
        if not isinstance(data, dict) or name not in data:
            raise RunError(f"{str(path)!r} lacks {name!r}; restore the file")
    return tuple(scenarios_from_list(data[name], f"{name} in {str(path)!r}") for name in names)
