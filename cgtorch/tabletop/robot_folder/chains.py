"""Which chains of joints are arms, and what the others are.

An arm is a chain that begins after the torso, which several chains share, and ends in a hand or
far from where it begins. Legs, heads and short chains are told apart by what they carry, by where
they begin, and by whether they stand on the floor.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cgtorch.tabletop.robot_folder.fingers import NAMED, depth_of, extent, is_finger, is_jaw
from cgtorch.tabletop.robot_folder.pairs import Limb, heads, pairs
from cgtorch.tabletop.robot_folder.structure import Array, Structure

LEAST_JOINTS = 5  # of an arm, after the torso
FEW_JOINTS = 4  # of an arm, where no chain with more is one
FEWEST = 2  # joints of a chain after a body that make this body a torso
HAND_JOINTS = 3
"""Joints before fingers of one joint, alike, or called so. They are no arm, nor is a finger after
them."""
CLAW = 0.2  # of the length of an arm, that of claws of one joint beside each other at most
PAIR = 0.5  # of it, that of such claws at most if one follows another
ON_FLOOR = 0.05  # m: links within this distance of the lowest point stand on the floor
LEAST_FINGERS = 3  # of a hand that no arm carries
DOWN = 0.5  # of the reach of a leg, how far below its begin the floor is
NEAR = 0.5  # of the farthest reach of a chain, that of one that is no arm
PARALLEL = 0.999  # cosine of the axes of rods
UPRIGHT = 0.9  # cosine of a torso's slide to the vertical

ARM, LEG, HEAD, BARE, SHORT, CLOSE, BRANCH, FINGER = (
    "arm", "a leg", "a head", "without fingers, which others have", "too few joints",
    "its end is close", "on another arm", "a finger",
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

    @property
    def before(self) -> str:
        """The last joint of the torso, or "" without a torso."""
        return self.joints[self.shared - 1].name if self.shared else ""

    def __str__(self) -> str:
        first, last = self.own[0].name, self.own[-1].name
        joints = f"{len(self.own)} joints from {first!r} to {last!r}"
        return joints if len(self.own) > 1 else f"what hangs from {first!r}"


def chains_of(structure: Structure) -> list[Chain]:
    """All chains of at least two joints that end somewhere, and fingers, with what they are."""
    ends = list(_ends(structure, structure.base))
    paths = [structure.path(link) for link, _ in ends]
    found = [
        Chain(link, tuple(path), _shared(structure, path, paths), fingers)
        for (link, fingers), path in zip(ends, paths, strict=True)
    ]
    found = [c for c in found if len(c.own) >= FEWEST or (c.own and NAMED.search(c.own[0].name))]
    judged = _judged(structure, found, LEAST_JOINTS)
    if any(chain.kind == ARM for chain in judged):
        return judged
    return _judged(structure, found, FEW_JOINTS)


def _judged(structure: Structure, found: list[Chain], least: int) -> list[Chain]:
    """The chains with what they are, if an arm has some joints at least."""
    long = [chain for chain in found if len(chain.own) >= least]
    legs = _legs(structure, long, [chain for chain in found if len(chain.own) >= FEW_JOINTS])
    reach = {chain.link: _reach(structure, chain) for chain in long if chain.link not in legs}
    limbs = [chain for chain in long if chain.link not in legs]
    necks, mirrored = _beside(structure, limbs, reach)
    fingered = any(chain.fingers for chain in limbs if chain.link not in necks)
    hand = _hand_alone(structure, found)

    def kind(chain: Chain) -> str:
        if chain not in long:
            return FINGER if NAMED.search(chain.own[0].name) else SHORT
        if chain.link in legs:
            return LEG
        if chain.link in hand:
            return FINGER
        if chain.link in necks:
            return HEAD
        if fingered and not chain.fingers and chain.link not in mirrored:
            return BARE
        first = [each for each in long if each.own[0] is chain.own[0]]
        if max(first, key=lambda each: (each.fingers, reach.get(each.link, 0.0))) is not chain:
            return BRANCH
        return ARM if reach[chain.link] >= NEAR * max(reach.values()) else CLOSE

    return [replace(chain, kind=kind(chain)) for chain in found]


def _beside(
    structure: Structure, limbs: list[Chain], reach: Mapping[str, float]
) -> tuple[set[str], set[str]]:
    """The ends of heads, and of chains that are as another on the other side, with fingers."""
    seen = [
        Limb(
            structure.pose(chain.own[0].child)[:3, 3],
            len(chain.own),
            _length(structure, chain.own),
            reach[chain.link],
        )
        for chain in limbs
    ]
    sides = [(limbs[i], limbs[j]) for i, j in pairs(seen)]
    mirrored = {each.link for side in sides if any(c.fingers for c in side) for each in side}
    return {limbs[i].link for i in heads(seen)}, mirrored


def told(chains: Sequence[Chain]) -> str:
    """What is no arm, and why, in words; "" if there is nothing. Wheels are not told."""
    wheels = [all(joint.type == "continuous" for joint in chain.own) for chain in chains]
    others = [c for c, wheel in zip(chains, wheels, strict=True) if c.kind != ARM and not wheel]
    return "; ".join(f"{chain} ({chain.kind})" for chain in others)


def slides_upright(structure: Structure, joint: Any) -> bool:
    """Whether a joint moves what it carries up and down."""
    return joint.type == "prismatic" and abs(float(_axis(structure, joint)[2])) > UPRIGHT


def _ends(structure: Structure, link: str) -> Iterator[tuple[str, bool]]:
    """The bodies at the ends of what hangs from a link, and whether they have fingers."""
    moved = _seen_to_move(structure, structure.moved(link))
    if len(moved) == 1:
        jaw = not depth_of(structure, moved[0]) or is_jaw(structure, link, moved[0])
        fingers = moved if jaw else []
    else:
        path, far = structure.path(link), 0.0
        least = FEW_JOINTS if len(moved) > FEWEST else LEAST_JOINTS
        if _named_or_alike(structure, moved):
            least = HAND_JOINTS
        if all(depth_of(structure, joint) <= 1 for joint in moved):
            share = PAIR if _follow(moved) else CLAW
            least, far = HAND_JOINTS, share * _length(structure, path)
        hand = len(path) >= least
        fingers = [joint for joint in moved if hand and is_finger(structure, joint, far)]
    further = [joint for joint in moved if joint not in fingers]
    if not further and link != structure.base:
        yield link, bool(fingers)
    for joint in further:
        yield from _ends(structure, joint.child)


def _named_or_alike(structure: Structure, joints: list[Any]) -> bool:
    """Whether what hangs from joints is called fingers, or is the same, with too few for an arm."""
    if joints and all(NAMED.search(joint.name) for joint in joints):
        return True
    kinds = {(depth_of(structure, j), round(extent(structure, j.child), 3)) for j in joints}
    return len(kinds) == 1 and max(kinds)[0] <= FEWEST


def _follow(joints: list[Any]) -> bool:
    """Whether one of joints follows another of them."""
    names = {joint.name for joint in joints}
    return any(joint.mimic is not None and joint.mimic.joint in names for joint in joints)


def _hand_alone(structure: Structure, found: list[Chain]) -> set[str]:
    """The ends of fingers that hang from one body, three or more, where nothing stands."""
    floor = _floor(structure)
    if any(_stands(structure, chain, floor) for chain in found):
        return set()
    short = [
        chain
        for chain in found
        if len(chain.own) >= HAND_JOINTS
        and not chain.fingers
        and is_finger(structure, chain.own[0])
    ]
    begins = Counter(chain.before for chain in short)
    return {chain.link for chain in short if begins[chain.before] >= LEAST_FINGERS}


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
        if other is not path and others >= FEWEST and torso and same > count:
            count = count if _rods(structure, path[same:], other[same:]) else same
    for i, joint in enumerate(path):
        alone = i >= count and slides_upright(structure, joint)
        if alone and _freedom(structure, path[i + 1 :]) >= FEW_JOINTS + 1:
            count = i + 1
    return count


def _rods(structure: Structure, joints: list[Any], other: list[Any]) -> bool:
    """Whether other joints are those of the rods of a linkage, which move in a plane only."""
    return _in_plane(structure, other) and not _in_plane(structure, joints)


def _in_plane(structure: Structure, joints: list[Any]) -> bool:
    """Whether joints move a thing in a plane only."""
    axes = np.array([_axis(structure, joint) for joint in joints]).reshape(-1, 3)
    turn = all(joint.type != "prismatic" for joint in joints)
    return turn and bool((abs(axes @ axes[:1].T) > PARALLEL).all())


def _axis(structure: Structure, joint: Any) -> Array:
    """(3,) a joint's axis in the base frame."""
    return structure.pose(joint.child)[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)


def _freedom(structure: Structure, joints: list[Any]) -> int:
    """In how many ways joints move what they carry, in a random posture: a telescope's in one."""
    model, rng = structure.urdf.model, np.random.default_rng(0)
    before = dict(zip(model.actuated_joint_names, model.cfg.tolist(), strict=True))
    model.update_cfg({joint.name: _within(joint, float(rng.uniform())) for joint in joints})
    twists = []
    for joint in joints:
        axis, slides = _axis(structure, joint), joint.type == "prismatic"
        linear = axis if slides else np.cross(structure.pose(joint.child)[:3, 3], axis)
        twists.append([*linear, *(np.zeros(3) if slides else axis)])
    model.update_cfg(before)
    return int(np.linalg.matrix_rank(np.array(twists), tol=1e-6))


def _within(joint: Any, share: float) -> float:
    """A position at a share of a joint's range, rad or m."""
    if joint.type == "continuous":
        return math.tau * share
    low, high = float(joint.limit.lower), float(joint.limit.upper)
    return low + share * (high - low)


def _reach(structure: Structure, chain: Chain) -> float:
    """How far a chain could reach from its first joint, m."""
    return _length(structure, chain.own) + extent(structure, chain.link)


def _length(structure: Structure, joints: Sequence[Any]) -> float:
    """How long the way is from the first of joints over all to the last, m."""
    places = np.array([structure.pose(joint.child)[:3, 3] for joint in joints]).reshape(-1, 3)
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _legs(structure: Structure, long: list[Chain], every: list[Chain]) -> set[str]:
    """The ends of long chains on which a robot stands, given every chain that may be an arm.

    The base does not reach the floor, but two or more of them do, or one does and two do not;
    those with fingers only if others with fingers do not, if these are wheels, or if there is one,
    a foot, and two others do not. Or they have no fingers and hang from the base where others hang
    from a torso that does not stand.
    """
    floor = _floor(structure)
    if lowest(structure, structure.rigid(structure.base)) <= floor:
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
    if len(hips) > 1 and not below and (upper or all(_leads_down(structure, c) for c in stand)):
        return hips
    return _from_base(long)


def _leads_down(structure: Structure, chain: Chain) -> bool:
    """Whether a chain begins below where its torso does, as a waist below the upper body."""
    first, own = (structure.pose(j.child)[2, 3] for j in (chain.joints[0], chain.own[0]))
    return bool(own < first - ON_FLOOR)


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


def _floor(structure: Structure) -> float:
    """The height below which something stands on the floor, m."""
    return ON_FLOOR + lowest(structure, structure.hanging(structure.base))


def _stands(structure: Structure, chain: Chain, floor: float) -> bool:
    """Whether a chain leads down to the floor."""
    first = chain.own[0].child
    low = lowest(structure, structure.hanging(first))
    drop = float(structure.pose(first)[2, 3]) - low
    return low <= floor and drop >= DOWN * _reach(structure, chain)


def lowest(structure: Structure, links: list[str]) -> float:
    """The height of the lowest point of links, or of what is seen of those without shapes, m."""
    return float(structure.seen(links)[:, 2].min(initial=math.inf))
