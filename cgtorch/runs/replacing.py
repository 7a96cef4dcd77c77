"""What must not be replaced by a file that is written about a run or a skill."""

import os
from pathlib import Path

from cgtorch.ground.errors import RunError

OF_A_RUN = (".json", ".jsonl", ".lock", ".safetensors")
"""The ends of names of files in the folder of a run itself; other files there are the user's."""


def check_output(
    output: Path, force: bool, read: Path, option: str = "--output", forced: str = "add --force"
) -> None:
    """RunError if the output is a folder, is in none, or is a file that must not be replaced.

    Among these are, also by `force`, those of the run, the stage or the skill file that is `read`.
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
    if output.exists() and _part_of(output, read):
        raise RunError(f"{str(output)!r} is a part of {str(read)!r}, which is read; {another}")
    if output.exists() and not force:
        raise RunError(f"{str(output)!r} exists; {another} or {forced}")


def _part_of(file: Path, read: Path) -> bool:
    """Whether an existing file belongs to what is read: a skill file, a run, or a stage of one."""
    file, read = Path(os.path.realpath(file)), Path(os.path.realpath(read))
    if read.is_file():
        return os.path.samefile(file, read)
    run = read if (read / "run.json").exists() else read.parent
    if run not in file.parents or not (run / "run.json").exists():
        return False
    return file.parent != run or file.suffix in OF_A_RUN or ".tfevents." in file.name
