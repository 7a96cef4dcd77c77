"""The tabletop as a domain: a robot in front of a table."""

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import torch
from torch import Generator, Tensor, nn

from cgtorch.domains.domain import Domain, Specialists
from cgtorch.domains.exploration import EXPLORATION, Exploration
from cgtorch.domains.files import Files
from cgtorch.domains.knowledge import Knowledge, imagine
from cgtorch.domains.models import Models
from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.domains.success import SuccessClassifier, fit_success_classifier
from cgtorch.domains.transition import TransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.graphs import ActionSet
from cgtorch.ground import distributed
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import RobotError, SettingsError
from cgtorch.ground.fields import Field, named
from cgtorch.ground.files import place_of, read_bytes, write_bytes
from cgtorch.improvement.compose import broad_group
from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.data import WITHIN, Scenes, collect, motions_to_try
from cgtorch.tabletop.edge_networks import edge_actions, edge_way_actions
from cgtorch.tabletop.kinematics import (
    Robot,
    graspable,
    has_posture,
    load_robot,
    robot_files,
)
from cgtorch.tabletop.models import compiled_models
from cgtorch.tabletop.models.success import COSTS, GAMMAS, GraspClassifier
from cgtorch.tabletop.models.transition import TableTransitionModel
from cgtorch.tabletop.physics import MujocoWorld, Physics
from cgtorch.tabletop.physics.model import mujoco
from cgtorch.tabletop.published import TabletopPictures
from cgtorch.tabletop.settings import WORLDS, TabletopSettings
from cgtorch.tabletop.stands import graspable_from_somewhere
from cgtorch.tabletop.world import (
    DRAWS,
    EDGES,
    PERCEPTS,
    ClearMotion,
    Noise,
    ObservedTabletop,
    Scenarios,
    TabletopWorld,
    draw_of,
    stage_scenarios,
)
from cgtorch.tabletop.world.percepts import BOX, parts_of, percept_fields

MARGIN = 0.03  # m that a way must be clearer in the models than in the world
TRANSITIONS, LABELS = 2000, 5500  # random data of the paper's method
MAX_BYTES = 64 * 2**20
WORTH_SHARING = 16  # grasps
THRIFT = {"kinematic": 1, "mujoco": 4}  # see `Scenes`
_Asked: TypeAlias = Callable[[Robot, Tensor, Tensor], Tensor]
GRASPS: Mapping[str, _Asked] = {"way": graspable, "posture": has_posture}
"""The condition of a successful grasp, by the setting `grasp`."""
ACTIONS = {"percept": paper_actions, "edge": edge_actions}
"""The actions of section VI, by the input of their networks."""
SPECIALISTS = {"percept": Specialists(), "edge": Specialists(broad_group, group=32, stall=15)}
"""How missed scenarios are grouped, by the input of networks. Networks that read the percept itself
can only solve scenarios that are close to each other. Networks in the edge's frame can solve many,
if they are evolved on diverse ones."""


class TabletopModels(Models["Tabletop"]):
    """Γ and C of the tabletop."""

    def explore(self, about: Exploration) -> Dataset:
        """See `Models.explore`; the paper's method gets as many random data as it had."""
        if not self.domain.published_data:
            return super().explore(about)
        about.purse.pay(EXPLORATION, Asked(motions=TRANSITIONS, tests=LABELS))
        return collect(self._scenes(about.kind), TRANSITIONS, LABELS, about.generator)

    def worth_trying(self, percept: Tensor, count: int, generator: Generator) -> Tensor:
        """See `Models.worth_trying`: most motions end near the object, in any direction."""
        return motions_to_try(percept, count, generator)

    def worth_testing(self, percept: Tensor) -> Tensor:
        """See `Models.worth_testing`: where the object may be within reach."""
        return parts_of(percept).object.norm(dim=-1) < WITHIN

    def _scenes(self, kind: str) -> Scenes:
        return Scenes(self.domain.world, kind, THRIFT[self.domain.settings.world])

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `Models.possible`."""
        return self._clear_motion(percept.device)(percept, control)

    def noisy(self, percept: Tensor) -> Tensor:
        """See `Models.noisy`: boxes of absent obstacles have no noise."""
        there = parts_of(percept).present.repeat_interleave(BOX, -1)
        size = percept.shape[-1] - there.shape[-1]
        return torch.cat([torch.ones_like(percept[..., :size]), there.to(percept)], -1)

    def unfitted(self) -> Mapping[str, Callable[[], nn.Module]]:
        """See `Models.unfitted`."""
        return {kind.__name__: kind for kind in (TableTransitionModel, GraspClassifier)}

    def fit_transition(self, data: Dataset, seed: int) -> tuple[TransitionModel, TransitionReport]:
        """See `Models.fit_transition`."""
        rows = data.percept, data.control, data.next_percept
        return fit_transition_model(TableTransitionModel(), *rows, seed=seed)

    def fit_success(self, data: Dataset, seed: int) -> tuple[SuccessClassifier, SuccessReport]:
        """See `Models.fit_success`."""
        rows = data.tested, data.succeeded
        return fit_success_classifier(GraspClassifier(), *rows, seed=seed, C=COSTS, gamma=GAMMAS)

    def imagine(
        self,
        knowledge: Knowledge,
        percepts: Tensor,
        replicas: int,
        generator: Generator,
        device: torch.device | str = "cpu",
    ) -> ModelEnvironment:
        """See `Models.imagine`; these models are compiled."""
        return imagine(
            knowledge, percepts, replicas, generator, device,
            possible=self._clear_motion(device), noisy=self.noisy, compiled=compiled_models,
        )  # fmt: skip

    def _clear_motion(self, device: torch.device | str) -> ClearMotion:
        """MoveBase's own check with a margin, so that the world's noise does not block a motion."""
        footprint = torch.tensor(self.domain.robot.description.footprint, device=device)
        more = footprint.new_tensor([-MARGIN, MARGIN, -MARGIN, MARGIN])
        return ClearMotion(footprint + more)


class RobotFiles(Files["Tabletop"]):
    """The robot's URDF, with shapes in place of meshes, and its description."""

    names = ("robot",)

    def write(self, folder: Path) -> None:
        """See `Files.write`."""
        (folder / "robot").mkdir(exist_ok=True)
        urdf, words = (
            read_bytes(source, MAX_BYTES, RobotError) for source in self.domain.robot_files()
        )
        urdf = self.domain.robot.urdf.xml if self.domain.robot.meshes else urdf
        for data, target in zip((urdf, words), _stored(folder), strict=True):
            write_bytes(target, data)

    @classmethod
    def read(cls, kind: type["Tabletop"], settings: Any, folder: Path) -> "Tabletop":
        """See `Files.read`."""
        return kind(settings, load_robot(*_stored(folder)))

    def options(self, folder: Path) -> Mapping[str, str]:
        """See `Files.options`: a robot that is not built in is read from the run."""
        pairs = zip(_stored(folder), robot_files(), strict=True)
        if all(own.read_bytes() == built_in.read_bytes() for own, built_in in pairs):
            return {"urdf": "", "robot": TabletopSettings.robot}
        urdf, robot = _stored(place_of(folder))
        return {"urdf": urdf.as_posix(), "robot": robot.as_posix()}


class Tabletop(Domain[Scenarios]):
    """A robot that reaches objects on a table (section VI).

    Attributes:
        robot: The robot.
        tabletop: The percept of table and object, a key of `cgtorch.tabletop.world.PERCEPTS`.
        obstacles: Maximum number of boxes in a scenario.
        networks: The input of networks, a key of `ACTIONS`.
        published_data: Whether models are learned from as many random data as in the paper.
    """

    settings: TabletopSettings
    settings_type = TabletopSettings
    kinds = ("perimeter", *EDGES, *(name for name in DRAWS if name.startswith("general")))
    stages: Mapping[str, str] = {"S0": "near", "S1": "left", "S2": "right", "S3": "far"}
    models = TabletopModels
    pictures = TabletopPictures
    files = RobotFiles
    control = (
        *named("dx", "dy", unit="m", low=-2, high=2),
        Field("dθ", "rad", -torch.pi, torch.pi, "angle"),
    )

    def __init__(
        self,
        settings: TabletopSettings | None = None,
        robot: Robot | None = None,
        tabletop: str = "box",
        obstacles: int = 0,
        networks: str = "edge",
        physics: Physics | None = None,
        published_data: bool = False,
    ) -> None:
        """A tabletop; by default with the robot of the settings, which can raise a RobotError."""
        super().__init__(settings)
        self.published_data = published_data
        self.robot = robot or load_robot(*self.robot_files())
        if self.settings.world == "mujoco":
            mujoco()  # which is said before anything long begins if it is missing
        self.physics = physics or Physics(self.robot)
        self.repeats = self.settings.noise == "seeded"
        self.tabletop, self.obstacles, self.networks = tabletop, obstacles, networks
        self.specialists = SPECIALISTS[networks]
        self.percept = percept_fields(PERCEPTS[tabletop] + BOX * obstacles)

    def for_run(self, kind: str, method: str) -> "Tabletop":
        """See `Adaptable.for_run`: the values of settings that are "auto"."""
        s = self.settings
        tabletop = usual_percept(kind) if s.percept == "auto" else s.percept
        networks = "percept" if method == "paper" else "edge"
        networks = networks if s.networks == "auto" else s.networks
        boxes = draw_of(kind)(0, Generator()).obstacles.shape[1]
        return self._like(
            tabletop=tabletop, obstacles=boxes, networks=networks, published_data=method == "paper"
        )

    def in_world(self, name: str) -> "Tabletop":
        """See `Adaptable.in_world`."""
        if name not in WORLDS:
            raise SettingsError(f"world is {name!r:.40}; use one of {', '.join(WORLDS)}")
        return self._like(settings=replace(self.settings, world=name))

    def other_measures(self) -> Mapping[str, "Tabletop"]:
        """See `Adaptable.other_measures`: in physics, with touches allowed or failing."""
        if self.settings.world != "mujoco":
            return {}
        if self.settings.touch == "fails":
            name, touch = "lifted, whatever the arm touched", "allowed"
        else:
            name, touch = "lifted without a touch of table or robot", "fails"
        return {name: self._like(settings=replace(self.settings, touch=touch))}

    def variants(self, kind: str) -> Iterable["Tabletop"]:
        """See `Adaptable.variants`.

        Networks in the edge's frame have the same size for all percepts; for these, the percept is
        that of a run with such scenarios.
        """
        percepts = sorted(PERCEPTS, key=lambda percept: percept != usual_percept(kind))
        every = itertools.product(ACTIONS, (0, 1), percepts)
        return (
            self._like(tabletop=percept, obstacles=boxes, networks=networks)
            for networks, boxes, percept in every
        )

    def watched(self, physics: Physics) -> "Tabletop":
        """The same tabletop with other physics, such as observed physics."""
        return self._like(physics=physics)

    def world_in(self, physics: Physics, scenarios: Scenarios) -> ObservedTabletop:
        """The world of some scenarios with other physics."""
        return self.watched(physics).world(scenarios)

    def _like(self, **changes: Any) -> "Tabletop":
        names = "settings", "robot", "tabletop", "obstacles", "networks", "physics"
        return Tabletop(**{**{name: getattr(self, name) for name in names}, **changes})

    def draw(self, kind: str, count: int, generator: Generator) -> Scenarios:
        """See `Domain.draw`."""
        return draw_of(kind)(count, generator)

    def tests(self, kind: str) -> Scenarios:
        """See `Domain.tests`: for an edge, five evenly spaced objects as in the paper."""
        return stage_scenarios(kind if kind in EDGES else "near", 5 if kind in EDGES else 0)

    def world(self, scenarios: Scenarios) -> ObservedTabletop:
        """See `Domain.world`."""
        footprint = self.robot.description.footprint
        s = self.settings
        noise = Noise(s.position_noise, s.heading_noise, repeats=self.repeats)
        if self.settings.world == "mujoco":
            return MujocoWorld(
                scenarios, self.physics, noise, percept=self.tabletop, touch=self.settings.touch
            )
        grasps = partial(_shared, GRASPS[self.settings.grasp], self.robot)
        return TabletopWorld(scenarios, grasps, footprint, noise, percept=self.tabletop)

    def solvable(self, scenarios: Scenarios) -> Tensor:
        """See `Surveyed.solvable`: objects that can be grasped from some place around them."""
        grasps = partial(GRASPS[self.settings.grasp], self.robot)
        return graspable_from_somewhere(scenarios, self.robot.description.footprint, grasps)

    def actions(self) -> ActionSet:
        """See `Domain.actions`."""
        if self.networks == "edge" and self.obstacles:
            x0, x1, y0, y1 = self.robot.description.footprint
            kept = x0 - MARGIN, x1 + MARGIN, y0 - MARGIN, y1 + MARGIN
            return edge_way_actions(len(self.percept), kept)
        return ACTIONS[self.networks](len(self.percept))

    def robot_files(self) -> tuple[Path, Path]:
        """The URDF and the description that the settings name."""
        s = self.settings
        given = Path(s.urdf) if s.urdf else None
        beside = s.urdf and s.robot == TabletopSettings.robot
        return robot_files(given, None if beside else Path(s.robot))


def _stored(folder: Path) -> tuple[Path, Path]:
    """The paths of a robot's URDF and description in a run."""
    return folder / "robot" / "robot.urdf", folder / "robot" / "robot.json"


def usual_percept(kind: str) -> str:
    """The default percept of a run with such scenarios, a key of `PERCEPTS`."""
    return "yaw" if kind.startswith("general") else "box"


def _shared(asked: _Asked, robot: Robot, position: Tensor, table: Tensor) -> Tensor:
    """The answers for many rows, which all ranks share; with few rows, each computes all."""
    if len(position) < WORTH_SHARING:
        return asked(robot, position, table)
    mine, rows = distributed.share(len(position)), len(position)
    return distributed.all_gather(asked(robot, position[mine], table[mine]), rows)
