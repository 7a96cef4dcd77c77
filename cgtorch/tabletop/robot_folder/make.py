"""Making a robot folder from a URDF: read, fit shapes, propose, try, draw and write."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import whole_folder, write_bytes, write_json
from cgtorch.tabletop.kinematics import Robot, graspable, load_robot
from cgtorch.tabletop.kinematics.description import DESCRIPTION, RobotDescription
from cgtorch.tabletop.kinematics.fitted import MeshFit, without_meshes
from cgtorch.tabletop.kinematics.meshes import package_places
from cgtorch.tabletop.kinematics.urdf import Urdf, checked_urdf, read_urdf
from cgtorch.tabletop.robot_folder.inertials import sound_inertials
from cgtorch.tabletop.robot_folder.picture import robot_picture
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.structure import Array

URDF, PICTURE, SHAPES = "robot.urdf", "robot.png", "shapes.json"
TABLE = (0.8, 1.6, 0.75)  # m: depth, width and height of the table on which a robot is tried
AHEAD = 0.05  # m from the footprint to that table
DEPTHS, ASIDE = (0.1, 0.2, 0.3), (-0.3, 0.0, 0.3)  # m: where objects are on it


@dataclass(frozen=True)
class Made:
    """A finished robot folder.

    Attributes:
        robot: The robot as loaded from the folder.
        meshes: The shapes fitted to meshes.
        inertials: Links whose mass or inertia was made up.
        notes: Additions and assumptions.
        grasps: (9,) bool, which objects on a table in front of the robot can be grasped.
    """

    robot: Robot
    meshes: tuple[MeshFit, ...]
    inertials: tuple[str, ...]
    notes: tuple[str, ...]
    grasps: torch.Tensor


def make_robot_folder(
    urdf: Path, folder: Path, wishes: Wishes | None = None, packages: Sequence[Path | str] = ()
) -> Made:
    """Make a folder with robot.urdf, which has no meshes, robot.json, shapes.json and robot.png.

    RobotError if the URDF or one of its collision meshes cannot be read, no arm is found, or a wish
    cannot be met; RunError if the folder exists or cannot be written. Then nothing is written.
    """
    read = checked_urdf(urdf, read_urdf(urdf))
    plain, meshes = without_meshes(read, package_places(packages))
    plain, inertials = sound_inertials(plain)
    proposal = propose(plain, wishes or Wishes(), _corners(read, meshes))
    with whole_folder(folder) as place:
        write_bytes(place / URDF, proposal.urdf.xml)
        words = proposal.words
        try:
            robot = _loaded(place, words)
            home = words.home or {
                name: round(float(position), 4)
                for arm, q in zip(robot.arms, robot.home, strict=True)
                for name, position in zip(arm.joint_names, q, strict=True)
            }
            robot = _loaded(place, dataclasses.replace(words, home=home))
        except RobotError as error:
            raise RobotError(str(error).replace(str(place), str(folder))) from None
        write_json(place / SHAPES, [_record(each) for each in meshes])
        write_bytes(place / PICTURE, robot_picture(robot))
    return Made(robot, meshes, inertials, proposal.notes, _tried(robot))


def _loaded(place: Path, words: RobotDescription) -> Robot:
    write_json(place / DESCRIPTION, _as_json(words))
    return load_robot(place / URDF, place / DESCRIPTION)


def _as_json(words: RobotDescription) -> dict[str, Any]:
    """The description in the form of its file, without empty optional values."""
    optional = {
        f.name for f in dataclasses.fields(words) if f.default_factory is not dataclasses.MISSING
    }
    values = {f.name: getattr(words, f.name) for f in dataclasses.fields(words)}
    values["arms"] = [dataclasses.asdict(arm) for arm in words.arms]
    plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in values.items()}
    return {key: value for key, value in plain.items() if value or key not in optional}


def _corners(urdf: Urdf, meshes: tuple[MeshFit, ...]) -> dict[str, list[Array]]:
    """The corners of meshes in the frames of links that collide as nothing else."""
    found: dict[str, list[Array]] = {}
    for each in meshes:
        only = all(c.geometry.mesh is not None for c in urdf.link(each.link).collisions)
        if each.kind == "collision" and each.fit is not None and only:
            placed = each.fit.corners @ each.pose[:3, :3].T + each.pose[:3, 3]
            found.setdefault(each.link, []).append(placed)
    return found


def _record(each: MeshFit) -> dict[str, Any]:
    """The shapes fitted to a mesh, for its file."""
    about = {"link": each.link, "file": each.file, "kind": each.kind}
    if each.fit is None:
        return {**about, "problem": each.problem}
    shapes = [
        {"kind": s.kind, "pose": (each.pose @ s.pose).tolist(), "sizes": list(s.sizes)}
        for s in each.fit.shapes
    ]
    volume = sum(shape.volume for shape in each.fit.shapes)
    return {
        **about,
        "shapes": shapes,
        "volume": volume,
        "convex_hull_volume": each.fit.hull_volume,
        "ratio": each.fit.ratio,
    }


def _tried(robot: Robot) -> torch.Tensor:
    """(9,) which objects on a table before the robot it can grasp."""
    depth, width, height = TABLE
    edge = robot.description.footprint[1] + AHEAD
    objects = torch.tensor([[edge + x, y, height] for x in DEPTHS for y in ASIDE])
    table = torch.tensor([edge + depth / 2, 0.0, 0.0, depth, width, height]).expand(len(objects), 6)
    return graspable(robot, objects, table)
