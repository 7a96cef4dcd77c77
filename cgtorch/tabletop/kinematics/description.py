"""The robot description: what a URDF does not say about a mobile manipulator.

It is a small JSON file beside the URDF with the attributes of `RobotDescription` as keys, such as
robots/pr2/robot.json; `body`, `gripper_joints` and `capsules` may be left out.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_json
from cgtorch.tabletop.kinematics.urdf import MOST

T = TypeVar("T")
Capsule = tuple[float, float, float, float, float, float, float]
"""Two end points and a radius (m), in the frame of a link."""

_WORDS: dict[type, str] = {dict: "a JSON object", list: "a list", str: "a non-empty string"}
_MAX_BYTES = 1_000_000


@dataclass(frozen=True)
class Arm:
    """One arm of the robot.

    Attributes:
        name: What the arm is called, such as `left`.
        base_link: The link the arm is mounted on.
        tool_frame: The link that is brought to the object; x points along the approach, y across
            the fingers.
    """

    name: str
    base_link: str
    tool_frame: str


@dataclass(frozen=True)
class RobotDescription:
    """What grasping and driving need to know about a robot beside its URDF.

    Attributes:
        name: What the robot is called.
        base_frame: The link on the floor that positions are relative to (x forward, y left, z up).
        footprint: The rectangle on the floor that bounds the body, (x min, x max, y min, y max), m.
        arms: The arms, in the order in which they are tried.
        torso_joint: The joint that lifts the arms, or None.
        torso_position: Where that joint stays (m or rad), or None without a torso joint.
        body: The links an arm must not touch.
        gripper_joints: Where joints outside the arms stay, such as open fingers (rad or m).
        capsules: Shapes that replace the URDF's collision elements of a link.
    """

    name: str
    base_frame: str
    footprint: tuple[float, float, float, float]
    arms: tuple[Arm, ...]
    torso_joint: str | None
    torso_position: float | None
    body: tuple[str, ...] = ()
    gripper_joints: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    capsules: Mapping[str, tuple[Capsule, ...]] = field(
        default_factory=lambda: MappingProxyType({})
    )


def load_description(path: Path | str) -> RobotDescription:
    """Read and check a robot description, a JSON file.

    Raises:
        RobotError: The file cannot be read, is not JSON, has an unknown or missing key, or a value
            of the wrong type or not finite.
    """
    content = read_json(path, _MAX_BYTES, RobotError)
    return _Reader(f"robot description {str(path)!r}").description(content)


@dataclass(frozen=True)
class _Reader:
    """Checks values and says where a bad one stands."""

    where: str

    def fail(self, what: str, value: object, wanted: str) -> RobotError:
        return RobotError(f"{self.where}: {what} is {value!r}: give {wanted}")

    def of(self, kind: type[T], what: str, value: Any) -> T:
        """A value that has to be of a type, and not an empty text."""
        if not isinstance(value, kind) or value == "":
            raise self.fail(what, value, _WORDS[kind])
        return value

    def texts(self, what: str, value: Any) -> tuple[str, ...]:
        return tuple(self.of(str, what, item) for item in self.of(list, what, value))

    def number(self, what: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(what, value, "a number")
        if not abs(value) <= MOST:
            raise self.fail(what, value, f"a finite number, of {MOST:.0e} at most")
        return float(value)

    def numbers(self, what: str, value: Any, count: int) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise self.fail(what, value, f"a list of {count} numbers")
        return tuple(self.number(what, item) for item in value)

    def keys(self, what: str, value: Any, kind: type[Arm | RobotDescription]) -> None:
        """Refuse a value without the keys that a class needs or with others than it has."""
        known = {each.name: each for each in fields(kind)}
        for key in self.of(dict, what, value):
            if key not in known:
                raise RobotError(
                    f"{self.where}: {what} has the unknown key {key!r}: known are "
                    f"{', '.join(known)}"
                )
        for key, each in known.items():
            if key not in value and each.default is each.default_factory is MISSING:
                raise RobotError(f"{self.where}: {what} lacks the key {key!r}: add it")

    def description(self, content: Any) -> RobotDescription:
        self.keys("the file", content, RobotDescription)
        x_min, x_max, y_min, y_max = self.numbers("footprint", content["footprint"], 4)
        if x_min >= x_max or y_min >= y_max:
            raise self.fail("footprint", content["footprint"], "[x min, x max, y min, y max] (m)")
        every = self.of(list, "arms", content["arms"])
        arms = tuple(self.arm(f"arms[{i}]", arm) for i, arm in enumerate(every))
        if not arms or len({arm.name for arm in arms}) < len(arms):
            raise self.fail("arms", every, "at least one arm, each with its own name")
        torso, position = content["torso_joint"], content["torso_position"]
        if (torso is None) != (position is None):
            raise self.fail(
                "torso_position", position, "a number with a torso_joint, null without one"
            )
        held = self.of(dict, "gripper_joints", content.get("gripper_joints", {}))
        shapes = self.of(dict, "capsules", content.get("capsules", {}))
        return RobotDescription(
            name=self.of(str, "name", content["name"]),
            base_frame=self.of(str, "base_frame", content["base_frame"]),
            footprint=(x_min, x_max, y_min, y_max),
            arms=arms,
            torso_joint=None if torso is None else self.of(str, "torso_joint", torso),
            torso_position=None if position is None else self.number("torso_position", position),
            body=self.texts("body", content.get("body", [])),
            gripper_joints=MappingProxyType(
                {name: self.number(f"gripper_joints[{name!r}]", x) for name, x in held.items()}
            ),
            capsules=MappingProxyType(
                {link: self.capsules(f"capsules[{link!r}]", x) for link, x in shapes.items()}
            ),
        )

    def arm(self, what: str, value: Any) -> Arm:
        self.keys(what, value, Arm)
        return Arm(**{key: self.of(str, f"{what}.{key}", name) for key, name in value.items()})

    def capsules(self, what: str, value: Any) -> tuple[Capsule, ...]:
        return tuple(self.capsule(what, item) for item in self.of(list, what, value))

    def capsule(self, what: str, value: Any) -> Capsule:
        x0, y0, z0, x1, y1, z1, radius = self.numbers(what, value, 7)
        if radius <= 0:
            raise self.fail(what, value, "two end points and a radius above 0 (m)")
        return x0, y0, z0, x1, y1, z1, radius
