"""The robot description: what a URDF does not contain about a mobile manipulator.

It is a small JSON file beside the URDF, such as robots/pr2/robot.json. Its keys are the attributes
of `RobotDescription`; `body`, `gripper_joints`, `capsules`, `home`, `gains` and `excludes` are
optional.
"""

import os
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from os.path import isdir, isfile  # which take any text for a path
from pathlib import Path
from types import UnionType
from typing import Any, TypeAlias, get_args, get_origin

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_json
from cgtorch.ground.given import given_path, shown
from cgtorch.tabletop.kinematics.valid import MOST

Capsule: TypeAlias = tuple[float, float, float, float, float, float, float]
"""Two end points and a radius (m), in the frame of a link."""

_WORDS = {dict: "a JSON object", list: "a list", str: "a non-empty string"}
_MAX_BYTES = 1_000_000
DEFAULT = "pr2"
DESCRIPTION = "robot.json"


@dataclass(frozen=True)
class Arm:
    """One arm of the robot, by its links.

    It is mounted on `base_link`. `tool_frame` is brought to the object, with x along the approach
    and y across the fingers.
    """

    name: str
    base_link: str
    tool_frame: str


@dataclass(frozen=True)
class RobotDescription:
    """The properties of a robot for grasping and driving that a URDF does not have.

    Attributes:
        base_frame: The link on the floor to which positions are relative (x forward, y left, z up).
        footprint: The rectangle on the floor that bounds the body, (x min, x max, y min, y max), m.
        arms: The arms, in the order in which they are tried.
        torso_joint: The joint that lifts the arms, or None.
        torso_position: The fixed position of that joint (m or rad), or None without a torso joint.
        body: The links that an arm must not touch.
        gripper_joints: Fixed positions of joints outside the arms, such as open fingers (rad or m).
        capsules: Shapes that replace the URDF's collision elements of a link.
        home: Positions of the arms' joints while the robot drives (rad or m). A joint that is not
            named is at 0, or as near as its limits allow. Without any, a posture is computed.
        gains: Stiffness of servos in physics, N m/rad or N/m, in place of defaults.
        excludes: Pairs of links that never collide, besides adjacent ones.
    """

    name: str
    base_frame: str
    footprint: tuple[float, float, float, float]
    arms: tuple[Arm, ...]
    torso_joint: str | None
    torso_position: float | None
    body: tuple[str, ...] = ()
    gripper_joints: Mapping[str, float] = field(default_factory=dict)
    capsules: Mapping[str, tuple[Capsule, ...]] = field(default_factory=dict)
    home: Mapping[str, float] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    excludes: tuple[tuple[str, ...], ...] = ()

    @property
    def held(self) -> dict[str, float]:
        """The positions of all fixed joints, including the torso's (rad or m)."""
        if self.torso_joint is None or self.torso_position is None:
            return dict(self.gripper_joints)
        return {**self.gripper_joints, self.torso_joint: self.torso_position}


def load_description(path: Path | str) -> RobotDescription:
    """Read and check a robot description, a JSON file.

    RobotError if it cannot be read, is not JSON, has an unknown or missing key, or a value of the
    wrong type or not finite.
    """
    content = read_json(path, _MAX_BYTES, RobotError)
    return _Reader(f"robot description {str(path)!r}").description(content)


@dataclass(frozen=True)
class _Reader:
    """Checks values and names the place of a wrong one."""

    where: str

    def fail(self, what: str, value: object, wanted: str) -> RobotError:
        return RobotError(f"{self.where}: {what} is {value!r}: give {wanted}")

    def description(self, content: Any) -> RobotDescription:
        words: RobotDescription = self.read("the file", content, RobotDescription)
        x_min, x_max, y_min, y_max = words.footprint
        if x_min >= x_max or y_min >= y_max:
            raise self.fail("footprint", content["footprint"], "[x min, x max, y min, y max] (m)")
        if not words.arms or len({arm.name for arm in words.arms}) < len(words.arms):
            raise self.fail("arms", content["arms"], "at least one arm, each with its own name")
        if (words.torso_joint is None) != (words.torso_position is None):
            wanted = "a number with a torso_joint, null without one"
            raise self.fail("torso_position", words.torso_position, wanted)
        for link, capsules in words.capsules.items():
            if not all(radius > 0 for *_, radius in capsules):
                wanted = "two end points and a radius above 0 (m) for each"
                raise self.fail(f"capsules[{link!r}]", content["capsules"][link], wanted)
        return words

    def read(self, what: str, value: Any, kind: Any) -> Any:
        """A JSON value as its annotation demands: number, text, tuple, mapping or dataclass."""
        outer, inner = get_origin(kind), get_args(kind)
        if outer is UnionType:
            return None if value is None else self.read(what, value, inner[0])
        if kind is float:
            return self.number(what, value)
        if outer is tuple and inner[-1] is not ...:
            if not isinstance(value, list) or len(value) != len(inner):
                raise self.fail(what, value, f"a list of {len(inner)} numbers")
            return tuple(self.number(what, item) for item in value)
        wanted: Any = str if kind is str else list if outer is tuple else dict
        if not isinstance(value, wanted) or value == "":
            raise self.fail(what, value, _WORDS[wanted])
        if is_dataclass(kind):
            return self.record(what, value, kind)
        if outer is tuple:
            return tuple(self.read(f"{what}[{i}]", x, inner[0]) for i, x in enumerate(value))
        if outer is Mapping:
            return {key: self.read(f"{what}[{key!r}]", x, inner[1]) for key, x in value.items()}
        return value

    def number(self, what: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(what, value, "a number")
        if not abs(value) <= MOST:
            raise self.fail(what, value, f"a finite number, of {MOST:.0e} at most")
        return float(value)

    def record(self, what: str, value: dict[str, Any], kind: Any) -> Any:
        """A dataclass from a value with all required keys and no unknown ones."""
        known = {each.name: each for each in fields(kind)}
        for key in value:
            if key not in known:
                raise RobotError(
                    f"{self.where}: {what} has the unknown key {key!r}: known are "
                    f"{', '.join(known)}"
                )
        for key, each in known.items():
            if key not in value and each.default is each.default_factory is MISSING:
                raise RobotError(f"{self.where}: {what} lacks the key {key!r}: add it")
        within = "" if kind is RobotDescription else f"{what}."
        read = {key: self.read(within + key, x, known[key].type) for key, x in value.items()}
        return kind(**read)


def robots_folder() -> Path:
    """The folder of the built-in robots: in an installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[2]
    for folder in (package / "robots", package.parent / "robots"):
        if (folder / DEFAULT / DESCRIPTION).is_file():
            return folder
    raise RobotError(
        f"no built-in robots in {str(package / 'robots')!r} or {str(package.parent / 'robots')!r}: "
        "install cgtorch again, or give a URDF and its robot description"
    )


def built_in_robots() -> list[str]:
    """Names of the built-in robots."""
    return sorted(path.parent.name for path in robots_folder().glob(f"*/{DESCRIPTION}"))


def robot_files(
    urdf: Path | str | None = None, description: Path | str | None = None
) -> tuple[Path, Path]:
    """The paths of a URDF and a robot description; one given by its own path may be missing.

    Args:
        urdf: The URDF, or None for the one beside the description.
        description: The name of a built-in robot, such as fetch; a folder with a URDF and a
            `robot.json`; the description itself; or None for `robot.json` beside the URDF, and for
            the PR2 without a URDF. Names of built-in robots take precedence over folders.

    Raises:
        RobotError: The description is none of these, or there is not exactly one URDF beside it.
    """
    urdf = None if urdf is None else given_path(urdf, "urdf", RobotError)
    if description is None and urdf is not None:
        return urdf, urdf.parent / DESCRIPTION
    robot = DEFAULT if description is None else description
    if not isinstance(robot, str | os.PathLike):
        raise RobotError(f"description is {shown(robot)}; give a path, or the name of a robot")
    words = Path(robot := os.fspath(robot))
    if robot in built_in_robots():
        words = robots_folder() / robot / DESCRIPTION
    elif isdir(robot):
        words /= DESCRIPTION
    if urdf is not None:
        return urdf, words
    if not isfile(words):
        raise RobotError(
            f"robot {str(description)!r} is no description, no folder with one and none of the "
            f"built-in robots ({', '.join(built_in_robots())}): give one of these"
        )
    beside = sorted(words.parent.glob("*.urdf"))
    if len(beside) != 1:
        raise RobotError(
            f"{len(beside)} URDFs lie beside the robot description {str(words)!r}: keep one there, "
            "or give the one that is meant"
        )
    return beside[0], words
