"""A run: a folder that holds everything it was made with and everything it produced.

run.json            format, versions, settings, and what was changed when
robot/              the URDF and its description, as they were when the run began
start/              what was known before the first stage: data, Γ, C
S0/ S1/ …           each finished stage: skill, W and M, data, Γ, C, specialists, result
auto-1/ auto-2/ …   each finished round of --stage auto: the same
journal/            of the stage or round that is not finished: all it has come to so far
set-aside/          journals of stages that were begun again, as settings or the version changed
ledger/             every accepted skill, with the evidence for eq. 1
summary.json        the final table
events.out.…        TensorBoard
"""

import itertools
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

import cgtorch
from cgtorch import native, ranks
from cgtorch.actions import ActionSet, check_action, resolve_actions
from cgtorch.errors import ActionError, GraphError, RunError
from cgtorch.experiments.perception import NETWORKS, networks_of, percept_of, usual_percept
from cgtorch.experiments.settings import RunSettings, settings_from_dict
from cgtorch.experiments.stages import STAGES, round_name
from cgtorch.files import read_json, write_bytes, write_json
from cgtorch.graphs import Skill, load_skill
from cgtorch.kinematics import Robot, graspable, load_robot, robots_folder
from cgtorch.world import LAB_NOISE, PERCEPTS, Noise, Scenarios, TabletopWorld, draw_of
from cgtorch.world.percepts import BOX

FORMAT, VERSION = "cgtorch-run", 1


@dataclass(frozen=True)
class Run:
    """An open run.

    Attributes:
        folder: where it is.
        settings: what it is made with.
        robot: the robot it is about.
        actions: the primitive actions.
    """

    folder: Path
    settings: RunSettings
    robot: Robot
    actions: ActionSet

    @property
    def world_of(self) -> Callable[[Scenarios], TabletopWorld]:
        """Makes the world of given scenarios, with the run's robot, noise and percept."""
        noise = Noise(self.settings.position_noise, self.settings.heading_noise)
        return tabletop_of(self.robot, noise, percept_of(self.settings))

    @property
    def stages(self) -> tuple[str, ...]:
        """The finished stages, in order, up to the first that is missing, then the rounds."""
        return (*itertools.takewhile(self._finished, STAGES), *self.rounds)

    @property
    def rounds(self) -> tuple[str, ...]:
        """The finished rounds of `--stage auto`, in order."""
        return tuple(itertools.takewhile(self._finished, map(round_name, itertools.count(1))))

    def _finished(self, stage: str) -> bool:
        return (self.folder / stage / "skill.json").is_file()


def tabletop_of(
    robot: Robot, noise: Noise, percept: str = "box"
) -> Callable[[Scenarios], TabletopWorld]:
    """Makes tabletop worlds for a robot that sees them with a percept of that name."""

    def world_of(scenarios: Scenarios) -> TabletopWorld:
        footprint = robot.description.footprint
        grasps = partial(_graspable, robot)
        return TabletopWorld(scenarios, grasps, footprint, noise, percept=percept)

    return world_of


def _graspable(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
    """`graspable`, its rows shared out among all ranks."""
    mine, rows = ranks.share(len(position)), len(position)
    return ranks.gathered(graspable(robot, position[mine], table[mine]), rows)


def versions() -> dict[str, str]:
    """What the last digits of a run's numbers depend on besides its settings, by name."""
    engine = "compiled" if native.available() else "torch"
    return {"cgtorch": cgtorch.__version__, "torch": str(torch.__version__), "engine": engine}


def create_run(
    folder: Path,
    settings: RunSettings,
    urdf: Path | None = None,
    description: Path | None = None,
) -> Run:
    """Begin a run in an empty or new folder; nothing is written unless all is in order.

    Raises:
        RobotError: the robot cannot be used.
        ActionError: an action cannot be found.
        RunError: the folder cannot be written or holds other things.
    """
    robot = load_robot(urdf, description)
    actions = _checked_actions(robot, settings)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RunError(f"{str(folder)!r} holds something that is no run; choose another folder")
    if folder.resolve() == Path.cwd():
        raise RunError("a run cannot replace the current folder; choose another, such as runs/one")
    source = robots_folder() / "pr2" / "pr2.urdf" if urdf is None else urdf
    words = source.parent / "robot.json" if description is None else description
    about = {"format": FORMAT, "version": VERSION, **versions()}
    try:
        robot_bytes, words_bytes = source.read_bytes(), words.read_bytes()
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise RunError(f"cannot write run {str(folder)!r} ({e.strerror}); choose another") from e
    with whole_folder(folder) as new:
        (new / "robot").mkdir()
        write_bytes(new / "robot" / "robot.urdf", robot_bytes)
        write_bytes(new / "robot" / "robot.json", words_bytes)
        write_json(new / "run.json", {**about, "settings": settings.to_dict()})
    return Run(folder, settings, robot, actions)


def open_run(folder: Path, trusted: Sequence[str] = ()) -> Run:
    """Open a run.

    Args:
        folder: where it is.
        trusted: "package.module:Class" of actions that may be imported. What a file names is not
            imported just because the file says so.

    Raises:
        RunError: there is none, or it is of another version, or damaged.
        ActionError: it uses an action that is not trusted or cannot be found, or does not use
            one that is trusted.
    """
    if not (folder / "run.json").is_file():
        raise RunError(f"{str(folder)!r} is no run (it has no run.json); give the folder of a run")
    about = read_json(folder / "run.json")
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise RunError(f"{str(folder / 'run.json')!r} is not of a cgtorch run; give another folder")
    if about.get("version") != VERSION:
        raise RunError(
            f"run {str(folder)!r} is of version {about.get('version')!r:.20}, this cgtorch reads "
            f"{VERSION}; use the version that wrote it"
        )
    settings = settings_from_dict(about.get("settings"))
    if unused := [spec for spec in trusted if spec not in settings.actions]:
        raise ActionError(
            f"run {str(folder)!r} was begun without action {unused[0]!r} and cannot use it; leave "
            "it out"
        )
    for spec in settings.actions:
        if ":" in spec and spec not in trusted:
            raise ActionError(
                f"run {str(folder)!r} uses action {spec!r}, which is code of its own; if you trust "
                f"it, add --actions {spec}"
            )
    robot = load_robot(folder / "robot" / "robot.urdf", folder / "robot" / "robot.json")
    return Run(folder, settings, robot, _checked_actions(robot, settings))


def _checked_actions(robot: Robot, settings: RunSettings) -> ActionSet:
    """The run's actions; those that are not built in are tried on two lanes."""
    scenarios = draw_of(settings.scenarios)(2, torch.Generator().manual_seed(0))
    world = tabletop_of(robot, LAB_NOISE, percept_of(settings))(scenarios)
    basic = networks_of(settings).actions(world.percept_size)
    actions = resolve_actions(settings.actions, basic)
    for name, action in zip(actions.names, actions.actions, strict=True):
        if name not in basic.names:
            check_action(name, action, world)
    return actions


def last_skill(path: Path, trusted: Sequence[str] = ()) -> tuple[Run, Skill]:
    """The last skill of a run's folder, or the skill of a stage's folder such as RUN/S2.

    `trusted` is that of `open_run`.

    Raises:
        RunError: there is no run, or no skill in it yet.
    """
    if (path / "run.json").is_file():
        run = open_run(path, trusted)
        if not run.stages:
            raise RunError(f"run {str(path)!r} has no finished stage; go on with --resume")
        return run, load_skill(path / run.stages[-1] / "skill.json", run.actions)
    if (path / "skill.json").is_file():
        run = open_run(path.absolute().parent, trusted)  # also of "."
        return run, load_skill(path / "skill.json", run.actions)
    raise RunError(f"{str(path)!r} is no run and no stage of one; give RUN or RUN/S2")


def lone_skill(
    path: Path, names: Sequence[str] = (), scenarios: str = RunSettings.scenarios
) -> tuple[str, Skill]:
    """The skill of a file that stands for itself, and the percept that its networks fit.

    Networks in the edge's frame are of the same size whatever they were evolved with; for these
    it is the percept that a run about such scenarios has.

    Args:
        path: the file.
        names: of further actions that it uses.
        scenarios: what it is to be tried on.

    Raises:
        GraphError: the file cannot be read or describes no skill, for whatever percept.
        ActionError: an action is not known.
    """
    errors: list[GraphError | ActionError] = []
    usual = usual_percept(scenarios)
    percepts = sorted(PERCEPTS, key=lambda percept: percept != usual)
    for networks, obstacles, percept in itertools.product(NETWORKS.values(), (0, 1), percepts):
        basic = networks.actions(PERCEPTS[percept] + BOX * obstacles)
        try:
            return percept, load_skill(path, resolve_actions(names, basic))
        except (GraphError, ActionError) as e:
            errors.append(e)
    raise next((e for e in errors if isinstance(e, GraphError)), errors[0])


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A folder that appears under its name with all its files, or not at all."""
    partial_path = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        try:
            partial_path.mkdir()
        except (OSError, ValueError) as e:
            reason = e.strerror if isinstance(e, OSError) else e
            raise RunError(f"cannot write {str(path)!r} ({reason}); check the folder") from e
        yield partial_path
        try:
            partial_path.replace(path)
        except OSError as e:
            raise RunError(f"cannot write {str(path)!r} ({e.strerror}); check the folder") from e
    finally:
        shutil.rmtree(partial_path, ignore_errors=True)
