"""What must not be replaced by a file that is written about a run or a skill."""

import os
from collections.abc import Sequence
from pathlib import Path

from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_json

OF_A_RUN = (".json", ".jsonl", ".lock", ".safetensors")
"""The ends of names of files in the folder of a run itself; other files there are the user's."""
WHY = ("failures.md", "failures.json", "kind-*.webp")
"""Files on why a skill fails, which may lie in a run but are no part of it."""
SO_FAR = "journal/*/skill.json"
"""The best skill so far of an interrupted stage, which the run itself replaces as it goes on."""


def check_output(
    output: Path, force: bool, read: Path, option: str = "--output", forced: str = "add --force"
) -> None:
    """RunError if the output is a folder, is in none, or is a file that must not be replaced.

    Among these are, also by `force`, the skill file that is `read`, and the files of any run.
    Messages call the path `option`, and what lets it replace a file `forced`.
    """
    another = f"choose another {option}"
    if output.is_dir():
        raise RunError(f"{str(output)!r} is a folder; {another}")
    if not output.parent.is_dir():
        raise RunError(
            f"{str(output.parent)!r} is no folder, so {str(output)!r} cannot be written; "
            f"make it, or {another}"
        )
    if output.exists() and not output.is_file():
        raise RunError(f"{str(output)!r} is a device or a pipe; {another}")
    if output.exists() and read.is_file() and os.path.samefile(output, read):
        raise RunError(f"{str(output)!r} is a part of {str(read)!r}, which is read; {another}")
    check_no_part(output, option)
    if output.exists() and not force:
        raise RunError(f"{str(output)!r} exists; {another} or {forced}")


def check_no_part(output: Path, option: str = "path", but: str = "") -> None:
    """RunError if the output is a file of a run, `but` for those that match a pattern."""
    if but and output.match(but):
        return
    if output.exists() and (run := _run_with(output)):
        raise RunError(
            f"{str(output)!r} is a part of the run {str(run)!r}; choose another {option}"
        )


def check_outputs(folder: Path, names: Sequence[str], force: bool, read: Path, option: str) -> None:
    """RunError if a folder has files of these names, or patterns, that must not be replaced."""
    for path in sorted(path for name in names for path in folder.glob(name)):
        check_output(path, force, read, option)


def _run_with(file: Path) -> Path | None:
    """The run of which an existing file, or the one to which it leads, is a part; else None."""
    file = Path(os.path.realpath(file))
    run = next((folder for folder in file.parents if _is_run(folder)), None)
    if run is None or any(map(file.match, WHY)):
        return None
    part = file.parent != run or file.suffix in OF_A_RUN or ".tfevents." in file.name
    return run if part else None


def _is_run(folder: Path) -> bool:
    """Whether a folder has the run.json of a run, even if that cannot be read."""
    path = folder / "run.json"
    if not path.is_file():
        return False
    try:
        about = read_json(path)
    except RunError:
        return True
    return isinstance(about, dict) and about.get("format") == "cgtorch-run"
