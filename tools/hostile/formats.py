"""The formats that the library reads: sound files of each, and the library's loader for them.

Files are small, so that a change hits what matters. Each loader is the one that commands use, and
what it returns is used a little, so that nothing stays lazy.
"""

import json
import math
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
import trimesh
from torch import Generator, nn

from cgtorch.domains.knowledge import taken
from cgtorch.evolution import EvolutionState, Population
from cgtorch.evolution.population import random_population
from cgtorch.graphs import ActionSet, load_skill
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_bytes, read_json, tensors_of, write_json
from cgtorch.improvement.checkpoint import (
    Checkpoint,
    Found,
    found_from,
    found_tensors,
    islands_from,
    state_from,
    state_tensors,
)
from cgtorch.improvement.trial import Trial, trial_from, trial_tensors
from cgtorch.report.reproduce import training_commands
from cgtorch.runs.journal import MAX_BYTES, FileJournal, recalled_generations
from cgtorch.runs.log import read_log
from cgtorch.runs.storage import (
    load_dataset,
    load_evidence,
    load_knowledge,
    load_population,
    load_progress,
    load_scenarios,
    save_scenarios,
    save_tensors,
)
from cgtorch.runs.stored_run import read_run
from cgtorch.svm import load_model_and_report, save_model
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import Robot, load_robot
from cgtorch.tabletop.kinematics.meshes import read_mesh
from cgtorch.tabletop.kinematics.shapes import fitted
from cgtorch.tabletop.models import GraspClassifier, TableTransitionModel
from cgtorch.tabletop.world import draw_of
from hostile.mutations import (
    CANARY,
    Mutation,
    damaged_bytes,
    damaged_json,
    damaged_log,
    damaged_tensors,
    damaged_xml,
)
from hostile.small_robot import URDF, WORDS

ROOT = Path(__file__).resolve().parents[2]
REFERENCE, PR2 = ROOT / "runs" / "reference", ROOT / "robots" / "pr2"
MODELS: Mapping[str, Callable[[], nn.Module]] = {
    kind.__name__: kind for kind in (TableTransitionModel, GraspClassifier)
}
LIKE, LIKE_CLUTTER = (draw_of(kind)(0, Generator()) for kind in ("perimeter", "general-clutter"))
SCENARIOS = 7  # that a journal is about
STEP, NOTE = "journal/S4/00000.safetensors", "journal/S4/00000-1.safetensors"
PART = "journal/S4/00000-1.0.safetensors"


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        mutation: what damages it.
        share: of all inputs; slow loaders have small ones.
        file: its place in the folder of the run.
        load: reads it, from the run's folder, with the run's actions.
        sources: sound files of it, from the same.
    """

    mutation: Mutation
    share: float
    file: str
    load: Callable[[Path, ActionSet], object]
    sources: Callable[[Path, ActionSet], list[bytes]]


def prepare(folder: Path) -> ActionSet:
    """Make a small run in a folder that is empty, but for the secret that no loader may tell."""
    shutil.copytree(REFERENCE, folder, ignore=shutil.ignore_patterns("*events*"))
    (folder / "secret").write_text(CANARY)
    (folder / "robot" / "robot.urdf").write_text(URDF)
    write_json(folder / "robot" / "robot.json", WORDS)
    stage = folder / "S3"
    gamma, report = load_model_and_report(stage / "gamma.safetensors", MODELS)
    assert isinstance(gamma, TableTransitionModel)  # noqa: S101
    data = load_dataset(stage / "data.safetensors")
    gamma = gamma.with_fewer_centres(16, data.percept[:200], data.control[:200])
    save_model(stage / "gamma.safetensors", gamma, report)
    for name in ("aside", "data"):
        save_tensors(stage / f"{name}.safetensors", vars(_few(data)), {"seed": "2"})
    return read_run(folder).actions


def _few(data: Dataset) -> Dataset:
    moves, tests = min(30, len(data.percept)), min(20, len(data.tested))
    return taken(data, torch.arange(moves), torch.arange(tests))


def _scenarios(folder: Path, actions: ActionSet) -> list[bytes]:
    path, found = folder / "x.json", []
    solved, missed = load_scenarios(REFERENCE / "S0" / "scenarios.json", LIKE)
    clutter = draw_of("general-clutter")(6, Generator().manual_seed(0))
    for one, other in ((solved[:8], missed[:4]), (clutter, clutter[:0])):
        save_scenarios(path, one, other)
        found.append(path.read_bytes())
    return found


def _read_scenarios(folder: Path, actions: ActionSet) -> object:
    """Scenarios without obstacles, as those of the run, or with them."""
    path = folder / "S0" / "scenarios.json"
    try:
        return load_scenarios(path, LIKE)
    except RunError:
        return load_scenarios(path, LIKE_CLUTTER)


def _evidence(folder: Path, actions: ActionSet) -> list[bytes]:
    data = read_json(folder / "S1" / "scenarios.json")
    few, most = {"W": data["W"][::20], "M": []}, len(data["W"])
    return [json.dumps({**few, "was": data["was"][:most:20]}).encode()]


def _logs(folder: Path, actions: ActionSet) -> list[bytes]:
    """The log of the run with few of its generations."""
    rows = read_log(folder)
    kept = [r for r in rows if r["event"] != "generation" or r["generation"] % 20 == 0]
    return ["".join(json.dumps(row) + "\n" for row in kept).encode()]


def _read_log(folder: Path, actions: ActionSet) -> object:
    run = read_run(folder)
    return run.results, training_commands(run, {}, read_log(folder))


def _populations(folder: Path, actions: ActionSet) -> list[bytes]:
    population = _population(actions)
    tensors = {**vars(population.graphs), "strategy": population.strategy}
    save_tensors(folder / "x.safetensors", tensors, {})
    return [(folder / "x.safetensors").read_bytes()]


def _population(actions: ActionSet) -> Population:
    return random_population(5, actions, 6, (2, 5), Generator().manual_seed(0))


def _journals(folder: Path, actions: ActionSet) -> list[bytes]:
    """An evolution that is over, and a trial."""
    found = {**found_tensors(_found(actions)), "generator": Generator().get_state()}
    data = load_dataset(folder / "S3" / "data.safetensors")
    counts, first = torch.arange(SCENARIOS), data.percept[:SCENARIOS]
    asked = Asked(9, 8, SCENARIOS, SCENARIOS)
    trial = trial_tensors(Trial(first, _found(actions).solved, counts, data, counts, asked))
    files = []
    for name, tensors in (("evolution x", found), ("trial of x", trial)):
        shutil.rmtree(folder / "journal", ignore_errors=True)
        FileJournal(folder / "journal" / "S4").record(name, tensors)
        files.append((folder / STEP).read_bytes())
    return files


def _found(actions: ActionSet) -> Found:
    return Found(_population(actions)[:1], torch.arange(SCENARIOS) < 3, 0.5, 3, 9, 1000, 1.5)


def _write_checkpoint(folder: Path, actions: ActionSet) -> None:
    """An evolution of two islands that is not over."""
    shutil.rmtree(folder / "journal", ignore_errors=True)
    state = EvolutionState(_population(actions), 9, _population(actions), 0.0)
    part = state_tensors(state)
    checkpoint = Checkpoint(found_tensors(_found(actions)), (lambda: part, lambda: part))
    FileJournal(folder / "journal" / "S4", seconds=0).record_checkpoint("evolution x", checkpoint)


def _checkpoint(name: str) -> Callable[[Path, ActionSet], list[bytes]]:
    def written(folder: Path, actions: ActionSet) -> list[bytes]:
        _write_checkpoint(folder, actions)
        return [(folder / name).read_bytes()]

    return written


def _read_journal(folder: Path, actions: ActionSet) -> object:
    recalled_generations(folder)
    journal = FileJournal(folder / "journal" / "S4")
    if journal.damaged:  # is told, and counts as never done
        raise RunError("damaged")
    if checkpoint := journal.recall_checkpoint("evolution x"):
        found_from(checkpoint.about, actions, SCENARIOS)
        return islands_from(checkpoint, actions, Generator(), 2)
    try:
        known = journal.recall("evolution x")
    except RunError:
        known = journal.recall("trial of x")
        return known and _used(trial_from(known, SCENARIOS))
    return known and found_from(known, actions, SCENARIOS)


def _used(trial: Trial) -> object:
    """A trial as improvement uses it: what it asked is counted, its successes are told apart."""
    purse = Purse()
    purse.add("trials", trial.asked)
    if min(vars(purse.total).values()) < 0:
        raise ArithmeticError("the trial has asked less than nothing")
    good = trial.succeeded
    return trial.percepts[good], [int(x) for x in trial.actions[good]], purse.total.actions


def _read_part(folder: Path, actions: ActionSet) -> object:
    """Its checksum in the note aside, so that it is looked at."""
    data = read_bytes(folder / PART, MAX_BYTES)
    try:
        tensors = tensors_of(data)
    except ValueError as e:  # is told, and counts as never done
        raise RunError("damaged") from e
    return state_from(tensors, actions, Generator(), 9)


def _read_seen(folder: Path, actions: ActionSet) -> object:
    """W and M with their first percepts, by which scenarios are grouped."""
    progress = load_progress(read_run(folder), folder / "S3")
    seen = progress.seen
    every = progress.solved.joined(progress.missed)
    if seen is None or len(seen) != len(every) or not bool(seen.isfinite().all()):
        raise ArithmeticError("the percepts are not those of W and M")
    return torch.cat([seen, progress.knowledge.dataset.percept])


def _read_models(folder: Path, actions: ActionSet) -> object:
    known = load_knowledge(folder / "S3", MODELS)
    data = known.dataset
    known.gamma(data.percept[:2], data.control[:2])
    return known.classifier(data.tested[:2])


def _read_run(folder: Path, actions: ActionSet) -> object:
    domain = read_run(folder).domain
    assert isinstance(domain, Tabletop)  # noqa: S101
    _moved(domain.robot)
    return domain


def _read_pr2(folder: Path, actions: ActionSet) -> object:
    robot = load_robot(folder / "pr2.urdf", PR2 / "robot.json")
    _moved(robot)
    return robot


def _read_mesh(name: str) -> Callable[[Path, ActionSet], object]:
    """A mesh, in all of whose shapes its numbers must be finite."""

    def read(folder: Path, actions: ActionSet) -> object:
        fit = fitted(read_mesh(folder / name))
        if not all(math.isfinite(x) for shape in fit.shapes for x in (*shape.sizes, shape.volume)):
            raise ArithmeticError("the mesh's shapes are not of finite numbers")
        return fit

    return read


def _meshes(kind: str) -> Callable[[Path, ActionSet], list[bytes]]:
    def written(folder: Path, actions: ActionSet) -> list[bytes]:
        made = [trimesh.creation.box((0.3, 0.2, 0.1)), trimesh.creation.cylinder(0.1, 0.2)]
        found = [mesh.export(file_type=kind) for mesh in made]
        return [data if isinstance(data, bytes) else data.encode() for data in found]

    return written


def _read_mesh_robot(folder: Path, actions: ActionSet) -> object:
    """A URDF with a mesh beside it, in place of the run's."""
    (folder / "robot" / "a.stl").write_bytes(_meshes("stl")(folder, actions)[0])
    robot = load_robot(folder / "robot" / "mesh.urdf", folder / "robot" / "robot.json")
    _moved(robot)
    return robot


def _mesh_urdf(folder: Path, actions: ActionSet) -> list[bytes]:
    text = (folder / "robot" / "robot.urdf").read_text()
    mesh = '<mesh filename="package://robot/a.stl" scale="0.1 0.1 0.1"/>'
    return [text.replace('<box size="0.2 0.1 0.05"/>', mesh).encode()]


def _moved(robot: Robot) -> None:
    """Use a robot a little; what cannot be computed must have been refused."""
    for arm in robot.arms:
        q = torch.zeros(1, len(arm.joint_names), dtype=torch.float64)
        parts = arm.frames(q), arm.solids.pose, arm.solids.size
        if not all(bool(part.isfinite().all()) for part in (*parts, robot.body.pose)):
            raise ArithmeticError(f"arm {arm.name} of the robot is not of finite numbers")


def _kept(*names: str) -> Callable[[Path, ActionSet], list[bytes]]:
    """Sources that are files of the run."""
    return lambda folder, actions: [(folder / name).read_bytes() for name in names]


FORMATS = {
    "skill": Format(
        damaged_json, 12, "S3/skill.json",
        lambda folder, actions: load_skill(folder / "S3" / "skill.json", actions).depth,
        _kept("S0/skill.json", "S1/skill.json"),
    ),
    "scenarios": Format(
        damaged_json, 12, "S0/scenarios.json",
        _read_scenarios, _scenarios,
    ),
    "run": Format(damaged_json, 3, "run.json", _read_run, _kept("run.json")),
    "log": Format(damaged_log, 32, "log.jsonl", _read_log, _logs),
    "evidence": Format(
        damaged_json, 8, "S1/scenarios.json",
        lambda folder, actions: load_evidence(folder / "S1" / "scenarios.json", LIKE)[1],
        _evidence,
    ),
    "dataset": Format(
        damaged_tensors, 12, "S3/data.safetensors",
        lambda folder, actions: load_dataset(folder / "S3" / "data.safetensors"),
        _kept("S3/data.safetensors"),
    ),
    "seen": Format(
        damaged_tensors, 3, "S3/seen.safetensors", _read_seen, _kept("S3/seen.safetensors")
    ),
    "population": Format(
        damaged_tensors, 12, "S0/specialists.safetensors",
        lambda folder, actions: load_population(folder / "S0" / "specialists.safetensors", actions),
        _populations,
    ),
    "gamma": Format(
        damaged_tensors, 4, "S3/gamma.safetensors", _read_models, _kept("S3/gamma.safetensors")
    ),
    "classifier": Format(
        damaged_tensors, 4, "S3/classifier.safetensors", _read_models,
        _kept("S3/classifier.safetensors"),
    ),
    "journal": Format(damaged_tensors, 6, STEP, _read_journal, _journals),
    "journal note": Format(damaged_tensors, 3, NOTE, _read_journal, _checkpoint(NOTE)),
    "journal part": Format(damaged_tensors, 3, PART, _read_part, _checkpoint(PART)),
    "urdf": Format(damaged_xml, 2, "robot/robot.urdf", _read_run, _kept("robot/robot.urdf")),
    "urdf pr2": Format(
        damaged_xml, 1, "pr2.urdf", _read_pr2, lambda *_: [(PR2 / "pr2.urdf").read_bytes()]
    ),
    "urdf of meshes": Format(
        damaged_xml, 1, "robot/mesh.urdf", _read_mesh_robot, _mesh_urdf
    ),
    "stl": Format(damaged_bytes, 2, "a.stl", _read_mesh("a.stl"), _meshes("stl")),
    "obj": Format(damaged_bytes, 2, "a.obj", _read_mesh("a.obj"), _meshes("obj")),
    "dae": Format(damaged_xml, 2, "a.dae", _read_mesh("a.dae"), _meshes("dae")),
    "robot.json": Format(damaged_json, 3, "robot/robot.json", _read_run, _kept("robot/robot.json")),
}  # fmt: skip
