"""The base of a robot: which link it is, where the floor is, where is forward, and a stand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree
from trimesh import transformations

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.origins import add_origin, words
from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf, at_rest, checked_urdf
from cgtorch.tabletop.robot_folder.chains import lowest, slides_upright
from cgtorch.tabletop.robot_folder.structure import Array, Structure

FLOOR_LINK, STAND_LINK = "base_footprint", "stand"
VIRTUAL = 2  # slides, or a slide and turns, of links without shapes that are a virtual base
FREE = "planar", "floating"
PLACES = ("world", "map", "odom")
"""Names of root links that do not belong to the robot."""
OFF_FLOOR = 0.02  # m that the lowest point may be from the base frame's plane
POSTURES = 64  # random postures of an arm, by which it is seen where it reaches
ONE_WAY = 0.25  # of its mean reach, how far these lead in one direction on average at least
ASIDE = math.pi / 3  # rad from x, from which a base is turned
LEAST = 0.1  # m: the sides of a stand


@dataclass(frozen=True)
class Base:
    """The base of a robot: the link that carries all else, and whether the user named it."""

    link: str
    given: bool = False


def base_of(structure: Structure, named: str | None, notes: list[str]) -> Base:
    """The base, which may be below joints by which a URDF lets it drive or fixes it in a world."""
    if named is not None:
        return Base(str(structure.urdf.link(named).name), given=True)
    link = _without_virtual(structure, notes)
    joints = structure.below[link]
    if link in PLACES and len(joints) == 1 and joints[0].type not in MOVING:
        link = joints[0].child
    return Base(link)


def _height(structure: Structure, chains: list[list[Any]], notes: list[str]) -> float:
    """How far the base is above the floor, m: of its footprint, or of all but the arms.

    Where an arm begins below that, as it hangs from a panel or only hands collide, of all.
    """
    known = [link for link in structure.rigid(structure.base) if "footprint" in link]
    if known:
        ground = float(structure.pose(known[0])[2, 3])
    else:
        every = structure.hanging(structure.base)
        moved = {link for chain in chains for link in structure.hanging(chain[0].child)}
        begin = min((float(structure.pose(c[0].parent)[2, 3]) for c in chains), default=math.inf)
        ground = lowest(structure, [link for link in every if link not in moved])
        if begin < ground - OFF_FLOOR and math.isfinite(whole := lowest(structure, every)):
            ground = min(whole, begin)
    if math.isfinite(ground):
        return -ground if abs(ground) > OFF_FLOOR else 0.0
    notes.append(f"nothing collides, so that {structure.base!r} is taken to be on the floor")
    return 0.0


def rest_positions(urdf: Urdf, others: Sequence[str] = ()) -> dict[str, float]:
    """The positions of all independent joints except some: 0, or as near as limits allow."""
    return {
        joint.name: at_rest(joint)
        for joint in urdf.model.robot.joints
        if joint.type in MOVING and joint.mimic is None and joint.name not in others
    }


def placed_base(
    structure: Structure, base: Base, chains: list[list[Any]], stand: float, notes: list[str]
) -> tuple[Urdf, str]:
    """The URDF with a frame on the floor from which x leads to where arms reach, and its name.

    If the base is such a frame, it is used. A `stand` of some height, in m, is put below it.
    RobotError if a named base is to have a stand.
    """
    urdf = structure.urdf
    if base.given:
        if stand:
            raise RobotError(f"a stand needs a base frame of its own, not {base.link!r}: name none")
        return urdf, base.link
    height, turn = _height(structure, chains, notes), _forward(structure, chains)
    if not (height or turn or stand):
        return urdf, base.link
    name = _unused(structure, FLOOR_LINK)
    root = etree.fromstring(urdf.xml)
    kept = set(structure.hanging(base.link))  # without the joints of a world or a virtual base
    for element in [*root.findall("link"), *root.findall("joint")]:
        ends = [element.get("name")] if element.tag == "link" else _ends(element)
        if not kept.issuperset(ends):
            root.remove(element)
    pose = transformations.rotation_matrix(-turn, [0, 0, 1])
    pose[2, 3] = height + stand
    add_frame(root, name, base.link, pose, above=True)
    if height:
        notes.append(
            f"{base.link!r} is {height:.3f} m above the lowest point of the robot, so the "
            f"link {name!r} was added there"
        )
    if turn:
        notes.append(
            f"the arms reach {math.degrees(turn):.0f} degrees away from the x of {base.link!r}, so "
            f"the link {name!r} was added, whose x leads there"
        )
    if stand:
        _add_stand(root, structure, name, pose, stand)
        notes.append(f"{base.link!r} stands on {STAND_LINK!r}, {stand} m high, which was added")
    return checked_urdf(urdf.path, root), name


def add_frame(root: Any, name: str, link: str, pose: Array, above: bool = False) -> None:
    """Add a link at a pose in the frame of another; with `above`, as the parent of the other."""
    etree.SubElement(root, "link", name=name)
    joint = etree.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
    add_origin(joint, pose)
    etree.SubElement(joint, "parent", link=name if above else link)
    etree.SubElement(joint, "child", link=link if above else name)


def _unused(structure: Structure, name: str) -> str:
    while name in structure.below:
        name += "_added"
    return name


def _ends(joint: Any) -> list[str | None]:
    return [joint.find(role).get("link") for role in ("parent", "child")]


def _add_stand(root: Any, structure: Structure, floor: str, pose: Array, stand: float) -> None:
    """Add a box of some height on the floor, as wide as what is fixed to the base."""
    points = structure.seen(structure.rigid(structure.base)) @ pose[:3, :3].T
    points = points if len(points) else np.zeros((1, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    sides = [*np.maximum(high - low, LEAST)[:2], stand]
    middle = transformations.translation_matrix([*(low + high)[:2] / 2, stand / 2])
    add_frame(root, _unused(structure, STAND_LINK), floor, middle)
    box = etree.SubElement(root.findall("link")[-1], "collision")
    etree.SubElement(etree.SubElement(box, "geometry"), "box", size=words(sides))


def _forward(structure: Structure, chains: list[list[Any]]) -> float:
    """The direction in which the arms reach, a multiple of 90 degrees, in rad; 0 is x.

    Arms that reach all round say nothing, nor do those that lead there on the whole.
    """
    model, rng = structure.urdf.model, np.random.default_rng(0)
    ways = np.empty((0, 3))
    for chain in chains:
        ends = [(-math.pi, math.pi) if j.type == "continuous" else _limits(j) for j in chain]
        low, high = np.array(ends).reshape(-1, 2).T
        for _ in range(POSTURES):
            at = rng.uniform(low, high)
            model.update_cfg({j.name: float(x) for j, x in zip(chain, at, strict=True)})
            way = structure.pose(chain[-1].child)[:3, 3] - structure.pose(chain[0].child)[:3, 3]
            ways = np.concatenate([ways, way[None]])
    x, y = ways[:, :2].mean(axis=0) if len(ways) else (0.0, 0.0)
    direction = math.atan2(y, x)
    if math.hypot(x, y) < ONE_WAY * np.linalg.norm(ways, axis=1).mean() or abs(direction) < ASIDE:
        return 0.0
    return round(direction / (math.pi / 2)) * math.pi / 2


def _limits(joint: Any) -> tuple[float, float]:
    return float(joint.limit.lower), float(joint.limit.upper)


def _without_virtual(structure: Structure, notes: list[str]) -> str:
    """The link below the joints by which a URDF lets its base drive.

    These are level slides, and turns, or a joint that is free in the plane or in space. Their links
    have no shapes, though they may have masses, which physics asks of what moves.
    """
    link, virtual = structure.base, list[Any]()
    while len(structure.below[link]) == 1 and not len(structure.seen([link])):
        joint = structure.below[link][0]
        virtual += [joint] if joint.type in (*MOVING, *FREE) else []
        link = joint.child
    slides = [j for j in virtual if j.type == "prismatic" and not slides_upright(structure, j)]
    free = any(joint.type in FREE for joint in virtual)
    if not free and (not slides or len(virtual) < VIRTUAL):
        return structure.base
    names = ", ".join(joint.name for joint in virtual)
    are = "is" if len(virtual) == 1 else "are"
    notes.append(f"{names} {are} taken for how the base drives, so that {link!r} is the base")
    return link
