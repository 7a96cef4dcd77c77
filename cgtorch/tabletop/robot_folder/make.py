"""Making a robot folder from a URDF: read, fit shapes, propose, try, draw and write."""

import dataclasses
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import whole_folder, write_bytes, write_json
from cgtorch.tabletop.kinematics import Robot, load_robot
from cgtorch.tabletop.kinematics.description import DESCRIPTION, RobotDescription
from cgtorch.tabletop.kinematics.fitted import MeshFit, without_meshes
from cgtorch.tabletop.kinematics.meshes import package_places
from cgtorch.tabletop.kinematics.urdf import Urdf, checked_urdf, read_urdf
from cgtorch.tabletop.robot_folder.fonts import fonts_for, without_glyph_warnings
from cgtorch.tabletop.robot_folder.homes import better_home, touching_at_home
from cgtorch.tabletop.robot_folder.proposal import Proposal, Wishes, propose
from cgtorch.tabletop.robot_folder.reach import Reached, reached
from cgtorch.tabletop.robot_folder.solid import solid, sound_inertials
from cgtorch.tabletop.robot_folder.srdf import Semantics, read_srdf, srdf_beside
from cgtorch.tabletop.robot_folder.stands import better_stand
from cgtorch.tabletop.robot_folder.still import without_still
from cgtorch.tabletop.robot_folder.structure import Array, Structure
from cgtorch.tabletop.robot_folder.turns import turned_over, turns_fully
from cgtorch.tabletop.robot_folder.units import check_units, far_meshes

URDF, PICTURE, SHAPES = "robot.urdf", "robot.png", "shapes.json"
VIEWS = (("from the right", 0, 2), ("from the front", 1, 2), ("from above", 0, 1))
"""The views, and which of x, y and z go to the right and up."""
REST, BODY, ARMS = "#b0b7bf", "#4a5a6a", ("#d95f02", "#1b9e77", "#7570b3", "#e7298a")
LIMITS_FIRST = "its limits look like degrees, as said above, so correct them first"
AXIS = 0.12  # m: how long the axes of a tool frame are drawn


@dataclass(frozen=True)
class Made:
    """A finished robot folder.

    Attributes:
        robot: The robot as loaded from the folder.
        meshes: The shapes fitted to meshes.
        inertials: Links whose mass or inertia was made up.
        notes: Additions and assumptions.
        reached: Which objects on a table in front of the robot can be grasped.
    """

    robot: Robot
    meshes: tuple[MeshFit, ...]
    inertials: tuple[str, ...]
    notes: tuple[str, ...]
    reached: Reached


def make_robot_folder(
    urdf: Path,
    folder: Path,
    wishes: Wishes | None = None,
    packages: Sequence[Path | str] = (),
    srdf: Path | None = None,
) -> Made:
    """Make a folder with robot.urdf, which has no meshes, robot.json, shapes.json and robot.png.

    The arms, home and pairs that never collide of an SRDF are used, by default of that beside the
    URDF, where the wishes do not say otherwise.

    RobotError if the URDF, the SRDF or a collision mesh cannot be read, no arm is found, or a wish
    cannot be met; RunError if the folder exists or cannot be written. Then nothing is written.
    """
    mended = list[str]()
    read = checked_urdf(urdf, read_urdf(urdf, mended))
    odd = check_units(read)
    read, still = without_still(read)
    srdf = srdf or srdf_beside(urdf)
    semantics = Semantics() if srdf is None else read_srdf(srdf, read)
    plain, meshes = without_meshes(read, package_places(packages))
    plain, notes = solid(plain)
    plain, inertials = sound_inertials(plain)
    wishes = _with_semantics(wishes or Wishes(), semantics)
    corners = _corners(read, meshes)
    proposal = propose(plain, wishes, corners, still)
    with whole_folder(folder) as place:
        try:
            robot, tried, over = _either_way_round(place, plain, proposal, wishes.stand)
        except RobotError as error:
            raise RobotError(str(error).replace(str(place), str(folder))) from None
        if odd and tried.why:
            tried = dataclasses.replace(tried, why=f"{tried.about}; {LIMITS_FIRST}")
        elif not tried.somewhere:
            tried = _on_a_stand(tried, plain, wishes, corners, proposal.words)
        write_json(place / SHAPES, [_record(each) for each in meshes])
        write_bytes(place / PICTURE, robot_picture(robot))
    return Made(
        robot,
        meshes,
        inertials,
        (
            *semantics.notes,
            *odd,
            *far_meshes(meshes),
            *mended,
            *notes,
            *proposal.notes,
            *over,
            *touching_at_home(robot),
        ),
        tried,
    )


def _either_way_round(
    place: Path, plain: Urdf, proposal: Proposal, stand: float
) -> tuple[Robot, Reached, list[str]]:
    """The robot in its folder, what it can grasp, and a note if its tool frames are turned over.

    Those that were added are if it can grasp nothing anywhere, but something then.
    """
    words, structure = proposal.words, Structure(proposal.urdf, proposal.words.base_frame)
    known = {link.name for link in plain.model.robot.links}
    added = [arm.tool_frame for arm in words.arms if arm.tool_frame not in known]
    added = [frame for frame in added if not turns_fully(structure, frame)]
    write_bytes(place / URDF, proposal.urdf.xml)
    robot, tried = _at_its_home(place, words, stand)
    if tried.somewhere or not added:
        return robot, tried, []
    write_bytes(place / URDF, turned_over(proposal.urdf, added).xml)
    other, then = _at_its_home(place, words, stand)
    if then.somewhere:
        frames = ", ".join(map(repr, added))
        return other, then, [f"{frames}: turned by half a turn about x, to grasp something at all"]
    write_bytes(place / URDF, proposal.urdf.xml)
    return _loaded(place, robot.description), tried, []


def _on_a_stand(
    tried: Reached,
    plain: Urdf,
    wishes: Wishes,
    corners: Mapping[str, Sequence[Array]],
    words: RobotDescription,
) -> Reached:
    """What a robot that can grasp nothing can, with the advice of a stand if one helps."""

    def on_stand(height: float) -> Robot | None:
        other = propose(plain, dataclasses.replace(wishes, stand=height), corners)
        if other.words.footprint == words.footprint:
            return None
        with TemporaryDirectory() as folder:
            write_bytes(Path(folder) / URDF, other.urdf.xml)
            return _loaded(Path(folder), other.words)

    if wishes.base_frame is not None:  # which is where it is
        return tried
    advice = better_stand(on_stand, wishes.stand)
    return dataclasses.replace(tried, why=f"{tried.about}; {advice}") if advice else tried


def _at_its_home(place: Path, words: RobotDescription, stand: float) -> tuple[Robot, Reached]:
    """The robot at its home, which is written into its folder, and what it can grasp from there.

    Another home is taken if nothing can be grasped from the computed one, but from that.
    """
    robot = _loaded(place, words)
    robot = _loaded(place, dataclasses.replace(words, home=words.home or _home_of(robot)))
    tried = reached(robot, stand)
    if not (words.home or tried.somewhere) and (better := better_home(robot)) is not None:
        robot = _loaded(place, dataclasses.replace(words, home=_home_of(better)))
        tried = reached(robot, stand)
    return robot, tried


def _home_of(robot: Robot) -> dict[str, float]:
    """The home of a robot in few digits, within the limits of its joints, rad or m."""
    found = _at_home(robot)
    for arm in robot.arms:
        ends = zip(arm.joint_names, arm.lower.tolist(), arm.upper.tolist(), strict=True)
        found |= {name: min(max(round(found[name], 4), low), high) for name, low, high in ends}
    return found


def _with_semantics(wishes: Wishes, semantics: Semantics) -> Wishes:
    """Wishes, and what an SRDF says where there are none."""
    if wishes.arms:
        return dataclasses.replace(wishes, excludes=wishes.excludes or semantics.apart)
    return dataclasses.replace(
        wishes,
        groups=semantics.arms,
        home=wishes.home or semantics.home,
        held={**semantics.opened, **wishes.held},
        excludes=wishes.excludes or semantics.apart,
    )


def _at_home(robot: Robot) -> dict[str, float]:
    """The positions of the arms' joints while the robot drives, rad or m."""
    found: dict[str, float] = {}
    for arm, q in zip(robot.arms, robot.home, strict=True):
        found |= dict(zip(arm.joint_names, q.tolist(), strict=True))
    return found


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
    about, fit = {"link": each.link, "file": each.file, "kind": each.kind}, each.fit
    if fit is None:
        return {**about, "problem": each.problem}
    shapes = [
        {"kind": s.kind, "pose": (each.pose @ s.pose).tolist(), "sizes": list(s.sizes)}
        for s in fit.shapes
    ]
    volumes = {"volume": sum(s.volume for s in fit.shapes), "convex_hull_volume": fit.hull_volume}
    return {**about, "shapes": shapes, **volumes, "ratio": fit.ratio}


def robot_picture(robot: Robot) -> bytes:
    """A PNG of a robot at home, from three sides.

    Grey is what nothing is asked of, dark what an arm must not touch, coloured the arms; the dashed
    rectangle is the footprint, and arrows are the tool frames: x red, y green, z blue.
    """
    words, structure = robot.description, Structure(robot.urdf, robot.description.base_frame)
    robot.urdf.model.update_cfg(_at_home(robot))
    colours = dict.fromkeys(structure.hanging(structure.base), REST)
    colours.update(dict.fromkeys(words.body, BODY))
    for i, arm in enumerate(robot.arms):
        first = robot.urdf.joint(arm.joint_names[0]).child
        colours.update(dict.fromkeys(structure.hanging(first), ARMS[i % len(ARMS)]))
    outline = np.array(words.footprint)
    corners = outline[[0, 1, 1, 0, 0]], outline[[2, 2, 3, 3, 2]], np.zeros(5)
    figure = Figure(figsize=(15, 6), layout="constrained")
    for axes, (view, right, up) in zip(figure.subplots(1, 3), VIEWS, strict=True):
        for name, colour in colours.items():
            for points in structure.shapes(name):
                _fill(axes, points[:, [right, up]], colour)
        axes.plot(corners[right], corners[up], "k--", linewidth=1)
        for tool in (arm.tool_frame for arm in words.arms):
            pose = structure.pose(tool)
            for axis, colour in enumerate(("red", "green", "blue")):
                line = np.stack([pose[:3, 3], pose[:3, 3] + AXIS * pose[:3, axis]])
                axes.plot(line[:, right], line[:, up], color=colour, linewidth=2)
        axes.set(aspect="equal", title=view)
        axes.set(xlabel=f"{'xyz'[right]} [m]", ylabel=f"{'xyz'[up]} [m]")
        axes.grid(alpha=0.3)
    figure.suptitle(words.name, family=fonts_for(words.name))
    robot.urdf.model.update_cfg(words.held)
    file = io.BytesIO()
    with without_glyph_warnings():
        FigureCanvasAgg(figure).print_png(file)
    return file.getvalue()


def _fill(axes: Any, points: np.ndarray, colour: str) -> None:
    try:
        outline = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return
    axes.fill(*outline.T, facecolor=colour, edgecolor=colour, alpha=0.35, linewidth=1)
