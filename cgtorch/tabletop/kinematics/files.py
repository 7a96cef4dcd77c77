"""The two files of a robot: by name for a built-in robot, by path for any other."""

from os.path import isdir, isfile  # which take any text for a path
from pathlib import Path

from cgtorch.ground.errors import RobotError

DEFAULT = "pr2"
DESCRIPTION = "robot.json"


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
    if description is None and urdf is not None:
        return Path(urdf), Path(urdf).parent / DESCRIPTION
    robot = DEFAULT if description is None else str(description)
    words = Path(robot)
    if robot in built_in_robots():
        words = robots_folder() / robot / DESCRIPTION
    elif isdir(robot):
        words /= DESCRIPTION
    if urdf is not None:
        return Path(urdf), words
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
