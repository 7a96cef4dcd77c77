"""Which chains of joints are arms, and what the others are.

An arm is a chain that begins after the torso, which several chains share, and ends in a hand or
far from where it begins. Legs, heads and short chains are told apart by what they carry, by where
they begin, and by whether they stand on the floor.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from trimesh.transformations import rotation_matrix

from cgtorch.tabletop.robot_folder.structure import Structure

LEAST_JOINTS = 5  # of an arm, after the torso
FEW_JOINTS = 4  # of an arm, where no chain with more is one
FEWEST = 2  # joints of a chain after a body that make this body a torso
HAND_JOINTS = 3  # before fingers of one joint; these are no arm, and neither is a finger after them
TOLD = 3  # joints of a chain that is no arm from which it is told
ON_FLOOR = 0.05  # m: links within this distance of the lowest point stand on the floor
FINGERS = ((9, 0.2), (4, 0.3))  # the most joints of a finger, and how far it reaches at most, m
HALF_TURN = 3.17  # rad that a jaw turns at most, with some room
JAW = 0.6  # of the reach of a jaw, that of what it closes against
OPEN = 0.8  # rad by which a jaw may be open at rest
NAMED = re.compile("finger|thumb", re.IGNORECASE)  # what no joint of an arm is called
MOST = 0.5  # of the joints before it, those that have its range if this says nothing
ASIDE = 0.2  # of its reach, how far its middle is from its axis at least
ACROSS = 0.5  # cosine of its axis to the way to its tip
DOWN = 0.5  # of the reach of a leg, how far below its begin the floor is
NEAR = 0.5  # of the farthest reach of a chain, that of one that is no arm
UPRIGHT = 0.9  # cosine of a torso's slide to the vertical

Array = npt.NDArray[np.float64]

ARM, LEG, HEAD, SHORT, CLOSE, BRANCH = (
    "arm", "a leg", "without fingers, which others have", "too few joints", "its end is close",
    "on another arm",
)  # fmt: skip


@dataclass(frozen=True)
class Chain:
    """A chain of joints from the base to an end.

    Attributes:
        link: The link that begins the rigid body at its end.
        joints: Its independent moving joints, from the base on.
        shared: How many of these belong to the torso.
        fingers: Whether the body at its end has fingers or a jaw.
        kind: `ARM`, or why it is none.
    """

    link: str
    joints: tuple[Any, ...]
    shared: int
    fingers: bool
    kind: str = ARM

    @property
    def own(self) -> tuple[Any, ...]:
        """The joints after the torso."""
        return self.joints[self.shared :]

    def __str__(self) -> str:
        first, last = self.own[0].name, self.own[-1].name
        return f"{len(self.own)} joints from {first!r} to {last!r}"


def chains_of(structure: Structure) -> list[Chain]:
    """All chains of at least two joints that end somewhere, with what they are."""
    ends = list(_ends(structure, structure.base))
    paths = [structure.path(link) for link, _ in ends]
    found = [
        Chain(link, tuple(path), _shared(structure, path, paths), fingers)
        for (link, fingers), path in zip(ends, paths, strict=True)
    ]
    found = [chain for chain in found if len(chain.own) >= FEWEST]
    judged = _judged(structure, found, LEAST_JOINTS)
    if any(chain.kind == ARM for chain in judged):
        return judged
    return _judged(structure, found, FEW_JOINTS)


def _judged(structure: Structure, found: list[Chain], least: int) -> list[Chain]:
    """The chains with what they are, if an arm has some joints at least."""
    long = [chain for chain in found if len(chain.own) >= least]
    legs = _legs(structure, long, [chain for chain in found if len(chain.own) >= FEW_JOINTS])
    fingered = any(chain.fingers for chain in long if chain.link not in legs)
    reach = {chain.link: _reach(structure, chain) for chain in long if chain.link not in legs}

    def kind(chain: Chain) -> str:
        if chain not in long:
            return SHORT
        if chain.link in legs:
            return LEG
        if fingered and not chain.fingers:
            return HEAD
        first = [each for each in long if each.own[0] is chain.own[0]]
        if max(first, key=lambda each: (each.fingers, reach.get(each.link, 0.0))) is not chain:
            return BRANCH
        return ARM if reach[chain.link] >= NEAR * max(reach.values()) else CLOSE

    return [replace(chain, kind=kind(chain)) for chain in found]


def told(chains: Sequence[Chain]) -> str:
    """What is no arm, and why, in words; "" if there is nothing."""
    others = [c for c in chains if c.kind != ARM and (len(c.own) >= TOLD or c.kind != SHORT)]
    return "; ".join(f"{chain} ({chain.kind})" for chain in others)


def slides_upright(structure: Structure, joint: Any) -> bool:
    """Whether a joint moves what it carries up and down."""
    axis = structure.pose(joint.child)[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
    return joint.type == "prismatic" and abs(float(axis[2])) > UPRIGHT


def _ends(structure: Structure, link: str) -> Iterator[tuple[str, bool]]:
    """The bodies at the ends of what hangs from a link, and whether they have fingers."""
    moved = _seen_to_move(structure, structure.moved(link))
    if len(moved) == 1:
        jaw = not _depth(structure, moved[0]) or _is_jaw(structure, link, moved[0])
        fingers = moved if jaw else []
    else:
        least = FEW_JOINTS if len(moved) > FEWEST else LEAST_JOINTS
        if all(_depth(structure, joint) <= 1 for joint in moved):
            least = HAND_JOINTS
        hand = len(structure.path(link)) >= least
        fingers = [joint for joint in moved if hand and _is_finger(structure, joint)]
    further = [joint for joint in moved if joint not in fingers]
    if not further and link != structure.base:
        yield link, bool(fingers)
    for joint in further:
        yield from _ends(structure, joint.child)


def _seen_to_move(structure: Structure, joints: list[Any]) -> list[Any]:
    """Joints without those that move nothing that is seen, where others beside them do."""
    bodies = [j for j in joints if len(structure.seen(structure.hanging(j.child)))]
    return bodies or joints


def _shared(structure: Structure, path: list[Any], paths: list[list[Any]]) -> int:
    """How many joints of a path are the torso's: those of other chains, or upright slides."""
    count = 0
    for other in paths:
        both = [one is two for one, two in zip(path, other, strict=False)]
        same = both.index(False) if False in both else len(both)
        rest, others = len(path) - same, len(other) - same
        torso = max(rest, others) >= LEAST_JOINTS or min(rest, others) > FEWEST
        if other is not path and others >= FEWEST and torso:
            count = max(count, same)
    for i, joint in enumerate(path):
        alone = i >= count and slides_upright(structure, joint)
        if alone and _freedom(structure, path[i + 1 :]) >= FEW_JOINTS + 1:
            count = i + 1
    return count


def _freedom(structure: Structure, joints: list[Any]) -> int:
    """In how many ways joints move what they carry, in a random posture: a telescope's in one."""
    model, rng = structure.urdf.model, np.random.default_rng(0)
    before = dict(zip(model.actuated_joint_names, model.cfg.tolist(), strict=True))
    model.update_cfg({joint.name: _within(joint, float(rng.uniform())) for joint in joints})
    twists = []
    for joint in joints:
        pose = structure.pose(joint.child)
        axis = pose[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
        slides = joint.type == "prismatic"
        linear = axis if slides else np.cross(pose[:3, 3], axis)
        twists.append([*linear, *(np.zeros(3) if slides else axis)])
    model.update_cfg(before)
    return int(np.linalg.matrix_rank(np.array(twists), tol=1e-6))


def _within(joint: Any, share: float) -> float:
    """A position at a share of a joint's range, rad or m."""
    if joint.type == "continuous":
        return math.tau * share
    low, high = float(joint.limit.lower), float(joint.limit.upper)
    return low + share * (high - low)


def _is_finger(structure: Structure, joint: Any) -> bool:
    """Whether what hangs from a joint is as short as a finger, and carries no fingers itself."""
    if any(len(_own(structure, link)) > 1 for link in structure.hanging(joint.child)):
        return False
    depth, reach = _depth(structure, joint), _extent(structure, joint.child)
    return any(depth <= most and reach <= far for most, far in FINGERS)


def _own(structure: Structure, link: str) -> list[Any]:
    """The independent joints of the rigid body that begins at a link."""
    return [joint for joint in structure.moved(link) if joint.mimic is None]


def _is_jaw(structure: Structure, link: str, joint: Any) -> bool:
    """Whether a joint moves a jaw, which closes against a part of the body that carries it.

    A joint that is called a finger's is one.
    """
    if not _is_finger(structure, joint):
        return False
    if NAMED.search(joint.name):
        return True
    if _depth(structure, joint) > 1:
        return False
    if _turns_far(structure, joint):
        return False
    pose = structure.pose(joint.child)
    axis = pose[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
    jaw = structure.seen(structure.hanging(joint.child)) - pose[:3, 3]
    other = structure.seen(structure.rigid(link)) - pose[:3, 3]
    if not len(jaw) or not len(other):
        return len(other) > 0  # what moves nothing that is seen is no wrist
    middle = (jaw.min(axis=0) + jaw.max(axis=0)) / 2
    if joint.type == "prismatic":
        middle = middle - (middle @ axis) * axis  # wherever it slides to
    aside = float(np.linalg.norm(middle))
    if aside < ASIDE * float(np.linalg.norm(jaw, axis=1).max()):
        return False  # it lies around its axis
    way = middle / aside
    reach = max(float((other @ closed).max()) for closed in _closed(joint, axis, way))
    return bool(abs(float(axis @ way)) < ACROSS and reach >= JAW * (jaw @ way).max())


def _closed(joint: Any, axis: Array, way: Array) -> list[Array]:
    """(3,) the ways to the tip of a jaw, which may be open in its rest position."""
    if joint.type != "revolute":
        return [way]
    low, high = float(joint.limit.lower), float(joint.limit.upper)
    turns = (max(-OPEN, min(0.0, low)), 0.0, min(OPEN, max(0.0, high)))
    return [rotation_matrix(turn, axis)[:3, :3] @ way for turn in turns]


def _turns_far(structure: Structure, joint: Any) -> bool:
    """Whether a joint turns farther than jaws do; not if most joints before it have its range."""
    *before, own = (_range(each) for each in structure.path(joint.child))
    alike = float(np.isclose(before or [own], own).mean())
    return HALF_TURN < own < math.inf and alike <= MOST


def _range(joint: Any) -> float:
    """How far a joint turns or slides, rad or m."""
    if joint.type == "continuous":
        return math.inf
    return float(joint.limit.upper) - float(joint.limit.lower)


def _depth(structure: Structure, joint: Any) -> int:
    """The most independent joints in a row, from this one on."""
    deeper = (_depth(structure, each) for each in structure.moved(joint.child))
    return (joint.mimic is None) + max(deeper, default=0)


def _extent(structure: Structure, link: str) -> float:
    """How far what hangs from a link reaches from it, m."""
    start = structure.pose(link)[:3, 3]
    links = structure.hanging(link)
    frames = np.stack([structure.pose(name)[:3, 3] for name in links])
    points = np.concatenate([frames, structure.seen(links)])
    return float(np.linalg.norm(points - start, axis=1).max())


def _reach(structure: Structure, chain: Chain) -> float:
    """How far a chain could reach from its first joint, m."""
    places = [structure.pose(joint.child)[:3, 3] for joint in chain.own]
    lengths = np.linalg.norm(np.diff(np.stack(places), axis=0), axis=1)
    return float(lengths.sum()) + _extent(structure, chain.link)


def _legs(structure: Structure, long: list[Chain], every: list[Chain]) -> set[str]:
    """The ends of long chains on which a robot stands, given every chain that may be an arm.

    The base does not reach the floor, but two or more of them do, or one does and two do not;
    those with fingers only if others with fingers do not, if these are wheels, or if there is one,
    a foot, and two others do not. Or they have no fingers and hang from the base where others hang
    from a torso that does not stand.
    """
    floor = ON_FLOOR + _lowest(structure, structure.hanging(structure.base))
    if _lowest(structure, structure.rigid(structure.base)) <= floor:
        return set()
    stand = [chain for chain in long if _stands(structure, chain, floor)]
    held = any(chain.fingers and chain not in stand for chain in every)
    others = len(long) - len(stand) > 1
    stand = [
        c
        for c in stand
        if held or not c.fingers or _on_wheels(structure, c) or (others and _one_jaw(structure, c))
    ]
    below = {chain.link for chain in stand if not chain.shared}
    if len(below) > 1 or (below and len(long) - len(stand) > 1):
        return below | _from_base(long)
    hips = {chain.link for chain in stand if chain.shared}
    upper = [chain for chain in every if not chain.shared]
    if len(hips) > 1 and upper and not below:
        return hips
    return _from_base(long)


def _on_wheels(structure: Structure, chain: Chain) -> bool:
    """Whether all that a chain has in place of fingers turns without end."""
    return all(joint.type == "continuous" for joint in structure.moved(chain.link))


def _one_jaw(structure: Structure, chain: Chain) -> bool:
    """Whether a chain has one thing in place of fingers, as a foot is taken for a jaw."""
    return len(structure.moved(chain.link)) == 1


def _from_base(long: list[Chain]) -> set[str]:
    """The ends of chains without fingers from the base, if others hang from a torso."""
    if not any(chain.shared for chain in long):
        return set()
    return {chain.link for chain in long if not chain.fingers and not chain.shared}


def _stands(structure: Structure, chain: Chain, floor: float) -> bool:
    """Whether a chain leads down to the floor."""
    first = chain.own[0].child
    low = _lowest(structure, structure.hanging(first))
    drop = float(structure.pose(first)[2, 3]) - low
    return low <= floor and drop >= DOWN * _reach(structure, chain)


def _lowest(structure: Structure, links: list[str]) -> float:
    """The height of the lowest point of links, m."""
    return float(structure.seen(links)[:, 2].min(initial=math.inf))
