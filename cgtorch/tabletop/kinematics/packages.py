"""Where the files are that a URDF names, which never leads out of the folders that were given."""

import os
import posixpath
import re
from collections.abc import Iterator, Mapping, Sequence
from os.path import isdir, isfile  # which take any text for a path
from pathlib import Path

from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_bytes

_NAME = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)
_MAX_BYTES = 1_000_000  # of a package.xml
_LISTED = 8  # places that an error names


def package_places(
    given: Sequence[Path | str] = (), environment: Mapping[str, str] = os.environ
) -> tuple[Path, ...]:
    """Folders in which packages are looked for, the given ones first.

    After them come those of the variable ROS_PACKAGE_PATH, and `share` in those of
    AMENT_PREFIX_PATH.
    """
    ros, ament = (
        [Path(place) for place in environment.get(name, "").split(os.pathsep) if place]
        for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
    )
    return (*map(Path, given), *ros, *(prefix / "share" for prefix in ament))


def file_named(name: str, urdf: Path, places: Sequence[Path]) -> Path:
    """The file that a URDF names: `package://PACKAGE/PATH`, `file://PATH`, or a path.

    A package is a folder of that name in one of the places, in a folder in one or in a folder in
    such a folder, a place itself, or a folder around the URDF. Any other path is relative to the
    URDF, and has to stay in its folder, its package or one of the places. Only the text counts: a
    link that somebody has put into a package leads where it leads, as in a workspace of links.

    RobotError if there is no such file, or the name leads out of where it may look.
    """
    scheme, colon, rest = name.partition("://")
    if not colon:
        return _near(name, name, urdf, places)
    if scheme == "file":
        return _near(rest, name, urdf, places)
    if scheme != "package":
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}: give a path, package://PACKAGE/PATH or "
            "file://PATH"
        )
    package, _, inside = rest.lstrip("/").partition("/")
    inside = posixpath.normpath(inside)
    if not _NAME.fullmatch(package):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which says no package: write "
            "package://PACKAGE/PATH"
        )
    if inside.startswith(("/", "..")):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which leads out of the package "
            f"{package!r}: name a file in it"
        )
    folders = list(_packages(package, urdf, places))
    for folder in folders:
        if isfile(folder / inside):
            return folder / inside
    looked = folders or [*places, *_around(urdf)[:1]]
    what = "it is not in" if folders else f"the package {package!r} is in none of"
    raise RobotError(
        f"URDF {str(urdf)!r} names the file {name!r}, which is missing: {what} {_listed(looked)}; "
        "give the folder that holds the package by --package-path or ROS_PACKAGE_PATH"
    )


def _near(path: str, name: str, urdf: Path, places: Sequence[Path]) -> Path:
    """A file by its path, absolute or relative to the URDF."""
    around = _around(urdf)
    found = Path(os.path.normpath(around[0] / path))
    own = next((folder for folder in around if isfile(folder / "package.xml")), around[0])
    roots = [around[0], own, *(Path(os.path.abspath(place)) for place in places)]
    if not any(found.is_relative_to(root) for root in roots):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which leads out of {_listed(roots)}: "
            "move it there, or give its folder by --package-path"
        )
    if not isfile(found):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which is missing: there is no "
            f"{str(found)!r}; put it there"
        )
    return found


def _packages(package: str, urdf: Path, places: Sequence[Path]) -> Iterator[Path]:
    """Folders that are a package of that name."""
    for folder in (*places, *_around(urdf)):
        if folder.name == package or _says(folder) == package:
            yield folder
    for place in filter(isdir, places):
        for depth in ("", "*/", "*/*/"):
            yield from sorted(filter(isdir, place.glob(depth + package)))


def _says(folder: Path) -> str | None:
    """The name that the package.xml of a folder gives its package, if there is one."""
    path = folder / "package.xml"
    if not isfile(path):
        return None
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        root = etree.fromstring(read_bytes(path, _MAX_BYTES, RobotError), parser)
    except (etree.XMLSyntaxError, ValueError):
        return None
    return (root.findtext("name") or "").strip() or None


def _around(urdf: Path) -> tuple[Path, ...]:
    """The folders around a URDF, the innermost first."""
    return tuple(Path(os.path.abspath(urdf)).parents)


def _listed(folders: Sequence[Path]) -> str:
    names = list(dict.fromkeys(repr(str(folder)) for folder in folders))
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more
