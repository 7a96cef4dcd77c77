"""The state of a run after a stage, as files: safetensors and JSON, never code."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeAlias

import safetensors.torch
import torch
from torch import Tensor, nn

from cgtorch.domains.knowledge import Knowledge, swift_gamma
from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.domains.rewarded_models import NAMES as COLUMNS_OF_KNOWN
from cgtorch.domains.rewarded_models import Known
from cgtorch.domains.success import SuccessClassifier
from cgtorch.domains.transition import TransitionModel
from cgtorch.evolution import Population, population_from
from cgtorch.graphs import ActionSet, Graphs, load_skill, save_skill
from cgtorch.ground.environment import Dataset, ScenarioBatch
from cgtorch.ground.errors import GraphError, RunError
from cgtorch.ground.files import (
    head_rows,
    in_order,
    read_bytes,
    read_json,
    tensors_of,
    write_bytes,
    write_json,
)
from cgtorch.improvement.events import SkillAccepted
from cgtorch.improvement.setup import Progress
from cgtorch.runs.belonging import MODELS, mark_of
from cgtorch.runs.stored_run import StoredRun
from cgtorch.svm import Choice, LearningCurve, load_model_and_report, save_model

GAMMA, CLASSIFIER = "gamma.safetensors", "classifier.safetensors"
DATA, ASIDE, KNOWN = "data.safetensors", "aside.safetensors", "known.safetensors"
SEEN = "seen.safetensors"
MAX_BYTES = 2**30
Unfitted: TypeAlias = Mapping[str, Callable[[], nn.Module]]
"""Functions that make unfitted models, by class name; see `Models.unfitted`."""


def save_tensors(path: Path, tensors: dict[str, Tensor], notes: dict[str, str]) -> None:
    """Write named tensors with notes, completely or not at all."""
    plain = {name: t.detach().cpu().contiguous() for name, t in tensors.items()}
    write_bytes(path, in_order(safetensors.torch.save(plain, metadata=notes)))


def load_tensors(path: Path, names: set[str]) -> dict[str, Tensor]:
    """Read tensors; RunError if the file is missing, damaged, too large, or has other names."""
    data = read_bytes(path, MAX_BYTES)
    try:
        found = tensors_of(data)
    except ValueError as e:
        raise RunError(f"cannot read {str(path)!r} ({e}); restore the file") from e
    if set(found) != names:
        odd = sorted(names ^ set(found))[0]
        raise RunError(f"{str(path)!r} lacks or has tensor {odd!r}; is it of this version?")
    return found


def load_dataset(path: Path) -> Dataset:
    """Read a dataset; RunError if its tensors are not finite or do not fit one another."""
    data = Dataset(**load_tensors(path, {f.name for f in fields(Dataset)}))
    for name, tensor in vars(data).items():
        wanted = torch.bool if name == "succeeded" else torch.float32
        if tensor.dtype != wanted:
            raise RunError(
                f"{name} of {str(path)!r} is {_plain(tensor.dtype)}, and {_plain(wanted)} is "
                "wanted; restore the file"
            )
    if not data.whole():
        raise RunError(
            f"the tensors of {str(path)!r} do not fit one another or are not finite; restore the "
            "file"
        )
    return data


def _plain(kind: torch.dtype) -> str:
    return str(kind).removeprefix("torch.")


def save_knowledge(folder: Path, knowledge: Knowledge, notes: dict[str, str]) -> None:
    """Write data, Γ and C into a folder."""
    save_tensors(folder / DATA, vars(knowledge.dataset), notes)
    said = [a.reason for a in knowledge.acceptances or ()]
    learned = dict(zip(("learned_gamma", "learned_classifier"), said, strict=False))
    save_model(folder / GAMMA, knowledge.gamma, knowledge.gamma_report)
    save_model(folder / CLASSIFIER, knowledge.classifier, knowledge.classifier_report)
    marks = {name: mark_of(folder / f"{name}.safetensors") for name in MODELS}
    save_tensors(folder / ASIDE, vars(knowledge.aside), {**notes, **learned, **marks})


def stage_knowledge(run: "StoredRun", stage: Path) -> Knowledge | None:
    """Γ, C and data of a stage; None if the run learns none, or the stage was passed on without."""
    if not any((stage / name).exists() for name in (GAMMA, CLASSIFIER)):
        return None
    return load_knowledge(stage, run.models.unfitted())


def load_knowledge(folder: Path, unfitted: Unfitted) -> Knowledge:
    """Read data, Γ and C from a folder.

    ModelError if a model file is damaged; RunError if it is another model's, or has no report.
    """
    gamma, about_gamma = load_model_and_report(folder / GAMMA, unfitted)
    classifier, about_c = load_model_and_report(folder / CLASSIFIER, unfitted)
    if not isinstance(gamma, TransitionModel) or not isinstance(classifier, SuccessClassifier):
        raise RunError(f"{str(folder)!r} holds other models than Γ and C; restore the files")
    try:
        choices = tuple(None if c is None else Choice(**c) for c in about_gamma["choice"])
        gamma_report = TransitionReport(**{**_fields(about_gamma), "choice": choices})
        report = SuccessReport(**{**_fields(about_c), "choice": Choice(**about_c["choice"])})
    except (TypeError, KeyError, RecursionError) as e:
        raise RunError(f"the reports of the models in {str(folder)!r} are damaged ({e})") from e
    data, aside = load_dataset(folder / DATA), load_dataset(folder / ASIDE)
    swift = swift_gamma(gamma, data)
    return Knowledge(data, gamma, swift, classifier, gamma_report, report, aside)


def _fields(report: dict[str, Any]) -> dict[str, Any]:
    """The fields of a report: JSON's lists as tuples, and the learning curve if there is one."""
    found: dict[str, Any] = _frozen(report)
    if found.get("learning_curve") is not None:
        found["learning_curve"] = LearningCurve(**found["learning_curve"])
    return found


def _frozen(value: Any) -> Any:
    """JSON's lists as tuples, at any depth."""
    if isinstance(value, dict):
        return {name: _frozen(one) for name, one in value.items()}
    return tuple(_frozen(one) for one in value) if isinstance(value, list) else value


def load_population(path: Path, actions: ActionSet) -> Population:
    """Read graphs and strategies; RunError if the file is damaged or a graph is not valid."""
    names = {f.name for f in fields(Graphs)} | {"strategy"}
    try:
        return population_from(load_tensors(path, names), actions)
    except GraphError as e:
        raise RunError(f"{str(path)!r} does not hold valid graphs; restore the file") from e


def scenarios_to_list(scenarios: ScenarioBatch) -> list[dict[str, Any]]:
    """One plain object per scenario, by field names; fields without numbers are left out."""
    parts = {name: value.tolist() for name, value in vars(scenarios).items() if value[:1].numel()}
    return [{name: rows[i] for name, rows in parts.items()} for i in range(len(scenarios))]


def scenarios_from_list(data: Any, like: ScenarioBatch, where: str) -> ScenarioBatch:
    """Scenarios like `like`, from the data of `scenarios_to_list`; RunError if a field is wrong."""
    if not isinstance(data, list):
        raise RunError(f"{where} is {data!r:.40}; give a list of scenarios")
    parts: dict[str, Tensor] = vars(like)
    wanted = {name: part[:1] for name, part in parts.items() if math.prod(part.shape[1:])}
    for i, row in enumerate(data):
        if not isinstance(row, dict) or set(row) != set(wanted):
            raise RunError(
                f"scenario {i} of {where} is {row!r:.60}; give {', '.join(sorted(wanted))}"
            )
        for name, part in wanted.items():
            if not _holds(row[name], part.shape[1:], part.dtype):
                whole = "true or false" if part.dtype == torch.bool else "whole numbers"
                kind = "finite numbers" if part.dtype.is_floating_point else whole
                raise RunError(
                    f"{name} of scenario {i} of {where} is {row[name]!r:.60}; give {kind} of shape "
                    f"{tuple(part.shape[1:])}"
                )
    made = {
        name: torch.tensor([row[name] for row in data if name in wanted], dtype=value.dtype).view(
            len(data), *value.shape[1:]
        )
        for name, value in parts.items()
    }
    return type(like)(**made)


def _holds(values: Any, shape: Sequence[int], dtype: torch.dtype) -> bool:
    """Whether values are nested lists of that shape with numbers of that type."""
    if shape:
        whole = isinstance(values, list) and len(values) == shape[0]
        return whole and all(_holds(value, shape[1:], dtype) for value in values)
    if dtype == torch.bool:
        return isinstance(values, bool)
    if dtype.is_floating_point:
        return type(values) in (int, float) and abs(values) < 1e15
    return type(values) is int and -(2**63) <= values < 2**63


WAS = ("W", "M", "new")
"""Where a scenario was before the skill of a stage was tried on it; "new" is in neither."""


def save_scenarios(
    path: Path,
    solved: ScenarioBatch,
    missed: ScenarioBatch,
    chance: bool = False,
    accepted: SkillAccepted[Any] | None = None,
) -> None:
    """Write W and M, and whether what was solved was found to be chance.

    If a skill was accepted, `was` says of each scenario of W and M where it was before (`WAS`).
    """
    data: dict[str, Any] = {"W": scenarios_to_list(solved), "M": scenarios_to_list(missed)}
    if accepted is not None:
        keys = map(json.dumps, scenarios_to_list(accepted.scenarios))
        was = dict(zip(keys, (WAS[not kept] for kept in accepted.keep.tolist()), strict=True))
        data["was"] = [was.get(json.dumps(row), "new") for row in (*data["W"], *data["M"])]
    write_json(path, {**data, "chance": chance})


def load_scenarios(path: Path, like: ScenarioBatch) -> tuple[ScenarioBatch, ...]:
    """Read W and M; RunError if one is missing or damaged, or others than those seen beside."""
    data, names = read_json(path), ("W", "M")
    for name in names:
        if not isinstance(data, dict) or name not in data:
            raise RunError(f"{str(path)!r} lacks {name!r}; restore the file")
    found = tuple(
        scenarios_from_list(data[name], like, f"{name} in {str(path)!r}") for name in names
    )
    beside, count = path.with_name(SEEN), sum(map(len, found))
    if (rows := head_rows(beside, "percepts")) not in (None, count):
        raise RunError(
            f"{str(path)!r} has {count} scenarios, and {SEEN} beside it the percepts of {rows}: "
            "one of them is of another stage; restore it"
        )
    return found


def load_evidence(path: Path, like: ScenarioBatch) -> tuple[ScenarioBatch, list[str], Tensor]:
    """The evidence for eq. 1: all B scenarios, where each was (`WAS`), and `succeeded` (B,) bool.

    Eq. 1a holds if none of W failed, eq. 1b if one of M succeeded. RunError if the stage accepted
    no skill, or the file is damaged.
    """
    solved, missed = load_scenarios(path, like)
    every, was = solved.joined(missed), read_json(path).get("was")
    if not isinstance(was, list) or len(was) != len(every) or any(w not in WAS for w in was):
        raise RunError(f"was in {str(path)!r} is {was!r:.40}, not of {len(every)} scenarios")
    return every, was, torch.arange(len(every)) < len(solved)


def save_progress(
    folder: Path, progress: Progress[Any], seed: int, accepted: SkillAccepted[Any] | None = None
) -> None:
    """Write everything that the next stage needs into a folder, and the evidence for eq. 1."""
    notes = {"seed": str(seed)}
    if progress.skill is not None:
        save_skill(folder / "skill.json", progress.skill)
        notes["skill"] = progress.skill.name
    known = progress.solved, progress.missed, progress.chance
    save_scenarios(folder / "scenarios.json", *known, accepted)
    if (seen := progress.seen) is not None:
        save_tensors(folder / SEEN, {"percepts": seen}, notes)
    if isinstance(progress.knowledge, Known):
        save_tensors(folder / KNOWN, progress.knowledge.tensors(), notes)
    elif progress.knowledge is not None:
        save_knowledge(folder, progress.knowledge, notes)
    if (population := progress.specialists) is not None:
        tensors = {**vars(population.graphs), "strategy": population.strategy}
        save_tensors(folder / "specialists.safetensors", tensors, notes)


def load_progress(run: StoredRun, folder: Path) -> Progress[Any]:
    """Read the files of `save_progress`."""
    solved, missed = load_scenarios(folder / "scenarios.json", run.like())
    knowledge: Knowledge | Known | None = None
    if run.imagines:
        known = load_tensors(folder / KNOWN, {*COLUMNS_OF_KNOWN})
        knowledge = run.reward_models.recalled(known)
    elif run.learns:
        knowledge = load_knowledge(folder, run.models.unfitted())
    chance = read_json(folder / "scenarios.json").get("chance") is True
    progress = Progress(None, solved, missed, knowledge, chance=chance)
    if (folder / "skill.json").is_file():
        progress = replace(progress, skill=load_skill(folder / "skill.json", run.actions))
    if len(solved) or len(missed):
        path = folder / SEEN
        shape = len(solved) + len(missed), len(run.domain.percept)
        seen = load_tensors(path, {"percepts"})["percepts"]
        if (seen.shape, seen.dtype) != (shape, torch.float32) or not seen.isfinite().all():
            raise RunError(
                f"the percepts in {str(path)!r} are {_plain(seen.dtype)} of shape "
                f"{tuple(seen.shape)}, and those of W and M are finite float32 of shape {shape}; "
                "restore the file"
            )
        progress = replace(progress, seen=seen)
    if (folder / "specialists.safetensors").is_file():
        population = load_population(folder / "specialists.safetensors", run.actions)
        progress = replace(progress, specialists=population)
    return progress
