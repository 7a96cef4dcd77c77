"""The robot description: what a URDF does not say about a mobile manipulator.

It is a small JSON file beside the URDF::

    {
      "name": "PR2",
      "base_frame": "base_footprint",
      "footprint": [-0.334, 0.334, -0.334, 0.334],
      "torso_joint": "torso_lift_joint",
      "torso_position": 0.15,
      "arms": [
        {"name": "left", "base_link": "torso_lift_link", "tool_frame": "l_gripper_tool_frame"}
      ],
      "body": ["base_link", "torso_lift_link"],
      "gripper_joints": {"l_gripper_l_finger_joint": 0.4},
      "capsules": {}
    }

`body`, `gripper_joints` and `capsules` may be left out.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.urdf import MOST

Capsule = tuple[float, float, float, float, float, float, float]
"""Two end points and a radius (m), in the frame of a link."""

_REQUIRED = ("name", "base_frame", "footprint", "torso_joint", "torso_position", "arms")
_OPTIONAL = ("body", "gripper_joints", "capsules")
_ARM_KEYS = ("name", "base_link", "tool_frame")
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
    torso_joint: str | None = None
    torso_position: float | None = None
    body: tuple[str, ...] = ()
    gripper_joints: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    capsules: Mapping[str, tuple[Capsule, ...]] = field(
        default_factory=lambda: MappingProxyType({})
    )


def load_description(path: Path | str) -> RobotDescription:
    """Read a robot description from a JSON file.

    Args:
        path: The file.

    Returns:
        The description, checked.

    Raises:
        RobotError: The file cannot be read, is not JSON, has an unknown or missing key, or a value
            of the wrong type or not finite.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise RobotError(
            f"robot description {str(path)!r} cannot be read ({error.strerror}): "
            "give the path of a JSON file such as robots/pr2/robot.json"
        ) from None
    if len(data) > _MAX_BYTES:
        raise RobotError(
            f"robot description {str(path)!r} is longer than {_MAX_BYTES} bytes: give a smaller "
            "file"
        )
    try:
        content = json.loads(data, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        raise RobotError(
            f"robot description {str(path)!r} is not valid JSON ({error}): correct it"
        ) from None
    return _Reader(f"robot description {str(path)!r}").description(content)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a JSON object that gives a key twice."""
    content = dict(pairs)
    if len(content) < len(pairs):
        (twice, _), *_ = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"key {twice!r} is given twice")
    return content


@dataclass(frozen=True)
class _Reader:
    """Checks values and says where a bad one stands."""

    where: str

    def fail(self, what: str, value: object, wanted: str) -> RobotError:
        return RobotError(f"{self.where}: {what} is {value!r}: give {wanted}")

    def keys(
        self, what: str, value: Any, required: tuple[str, ...], optional: tuple[str, ...]
    ) -> None:
        if not isinstance(value, dict):
            raise self.fail(what, value, "a JSON object")
        for key in required:
            if key not in value:
                raise RobotError(f"{self.where}: {what} lacks the key {key!r}: add it")
        for key in value:
            if key not in required + optional:
                known = ", ".join(required + optional)
                raise RobotError(
                    f"{self.where}: {what} has the unknown key {key!r}: known are {known}"
                )

    def text(self, what: str, value: Any) -> str:
        if not isinstance(value, str) or not value:
            raise self.fail(what, value, "a non-empty string")
        return value

    def number(self, what: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(what, value, "a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not abs(number) <= MOST:
            raise self.fail(what, value, f"a finite number, of {MOST:.0e} at most")
        return number

    def numbers(self, what: str, value: Any, count: int) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise self.fail(what, value, f"a list of {count} numbers")
        return tuple(self.number(what, item) for item in value)

    def items(self, what: str, value: Any) -> list[Any]:
        if not isinstance(value, list):
            raise self.fail(what, value, "a list")
        return value

    def mapping(self, what: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.fail(what, value, "a JSON object")
        return value

    def description(self, content: Any) -> RobotDescription:
        self.keys("the file", content, _REQUIRED, _OPTIONAL)
        x_min, x_max, y_min, y_max = self.numbers("footprint", content["footprint"], 4)
        if x_min >= x_max or y_min >= y_max:
            raise self.fail("footprint", content["footprint"], "[x min, x max, y min, y max] (m)")
        arms = tuple(self.arm(i, arm) for i, arm in enumerate(self.items("arms", content["arms"])))
        if not arms or len({arm.name for arm in arms}) < len(arms):
            raise self.fail("arms", content["arms"], "at least one arm, each with its own name")
        torso, position = content["torso_joint"], content["torso_position"]
        if (torso is None) != (position is None):
            raise self.fail(
                "torso_position", position, "a number with a torso_joint, null without one"
            )
        return RobotDescription(
            name=self.text("name", content["name"]),
            base_frame=self.text("base_frame", content["base_frame"]),
            footprint=(x_min, x_max, y_min, y_max),
            arms=arms,
            torso_joint=None if torso is None else self.text("torso_joint", torso),
            torso_position=None if position is None else self.number("torso_position", position),
            body=tuple(self.text("body", x) for x in self.items("body", content.get("body", []))),
            gripper_joints=MappingProxyType(
                {
                    joint: self.number(f"gripper_joints[{joint!r}]", value)
                    for joint, value in self.mapping(
                        "gripper_joints", content.get("gripper_joints", {})
                    ).items()
                }
            ),
            capsules=MappingProxyType(
                {
                    link: tuple(
                        self.capsule(f"capsules[{link!r}]", item)
                        for item in self.items(f"capsules[{link!r}]", value)
                    )
                    for link, value in self.mapping("capsules", content.get("capsules", {})).items()
                }
            ),
        )

    def arm(self, index: int, value: Any) -> Arm:
        what = f"arms[{index}]"
        self.keys(what, value, _ARM_KEYS, ())
        return Arm(**{key: self.text(f"{what}.{key}", value[key]) for key in _ARM_KEYS})

    def capsule(self, what: str, value: Any) -> Capsule:
        x0, y0, z0, x1, y1, z1, radius = self.numbers(what, value, 7)
        if radius <= 0:
            raise self.fail(what, value, "two end points and a radius above 0 (m)")
        return x0, y0, z0, x1, y1, z1, radius
