"""Whether the parts of a run belong together: the skill of each stage, and the seed of its data."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.ground.files import head_notes, read_json

SEEDED = "data", "aside", "known", "seen", "specialists"
"""The files of a stage whose notes have the seed of the run, though older ones may lack it."""


def check_parts(run: Path, stages: Iterable[str], seed: int) -> None:
    """RunError if a stage of a run holds another one's skill, or files of a run of another seed.

    Files that cannot be read are left to those who need them.
    """
    for stage in stages:
        skill = run / stage / "skill.json"
        if (name := _skill_name(skill)) not in (None, stage):
            raise RunError(
                f"{str(skill)!r} holds skill {name!r:.80}, not {stage!r}: its folder was moved or "
                "mixed with another; restore it"
            )
        for part in SEEDED:
            path = run / stage / f"{part}.safetensors"
            if (made := head_notes(path).get("seed")) not in (None, str(seed)):
                raise RunError(
                    f"{str(path)!r} was made with seed {made!s:.20}, and run.json says {seed}: one "
                    "of them is of another run; restore it"
                )


def _skill_name(path: Path) -> Any:
    """The name of the skill in a file; None if there is none that can be read."""
    with suppress(CgtorchError):
        data = read_json(path)
        return data.get("name") if isinstance(data, dict) else None
    return None
