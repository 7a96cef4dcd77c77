"""Whether a run, its parts and its domain belong together, as far as its files tell.

A skill file has the name of its stage, or in a round that accepted none that of an earlier one.
Other files have the seed of the run and the name of the skill beside them in their notes, and marks
of the models that were learned. The file run.json names the numbers of percepts and controls under
"percept" and "control". All but the first may be missing, as in runs of older versions.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from cgtorch.domains.domain import Domain
from cgtorch.ground.errors import CgtorchError, DomainError, RunError
from cgtorch.ground.files import head_notes, read_json

SEEDED = "data", "aside", "known", "seen", "specialists"
"""The files of a stage whose notes have the seed of the run, and the name of its skill."""
MODELS = "gamma", "classifier"
"""The files of a stage whose marks are in the notes of `aside`."""
MOST = 300  # characters of names in a message


def instead_of_run(
    path: Path, usual: str = "is no run (it has no run.json); give the folder of a run"
) -> str:
    """What a path is that has no run.json, and what to do: `usual`, or what is seen there."""
    if ((whole := path.absolute().parent) / "run.json").is_file():
        return f"is no run but a part of the run {str(whole)!r}; give that, or choose another"
    if path.is_file():
        return "is no run but a file; choose another, which is a folder"
    if (path / "log.jsonl").exists() or any(path.glob("*/skill.json")):
        return "has parts of a run, and its run.json is lost; restore that, or choose another"
    return usual


def fields_of(domain: Domain[Any]) -> dict[str, list[str]]:
    """The names of a domain's percept and control, as run.json has them."""
    return {
        part: [field.name for field in getattr(domain, part)] for part in ("percept", "control")
    }


def check_fields(run: Path, about: Mapping[str, Any], domain: Domain[Any]) -> None:
    """DomainError if a domain has other percepts or controls than run.json (`about`) names."""
    for part, now in fields_of(domain).items():
        was = about.get(part)
        if was is None or was == now:
            continue
        made = ", ".join(map(str, was)) if isinstance(was, list) else repr(was)
        raise DomainError(
            f"{type(domain).__name__} has {part} {', '.join(now):.{MOST}} by now, and run "
            f"{str(run)!r} was made with {made:.{MOST}}; bring that back, or train another run "
            "(--run-dir)"
        )


def mark_of(model: Path) -> str:
    """The mark of a model: a digest of its file's notes, as each fit has a report of its own."""
    return sha256(json.dumps(head_notes(model)).encode()).hexdigest()[:16]


def check_parts(run: Path, stages: Sequence[str], rounds: Sequence[str], seed: int) -> None:
    """RunError if a stage of a run holds parts of another one, or of a run of another seed.

    A round that accepted no skill holds one of before. Files that cannot be read are left to those
    who need them.
    """
    every = [*stages, *rounds]
    for place, stage in enumerate(every):
        skill, own = run / stage / "skill.json", every[: place + 1] if stage in rounds else [stage]
        if (name := _skill_name(skill)) not in (None, *own):
            raise RunError(
                f"{str(skill)!r} holds skill {name!r:.80}, not {stage!r}: its folder was moved or "
                "mixed with another; restore it"
            )
        notes = {part: head_notes(run / stage / f"{part}.safetensors") for part in SEEDED}
        for part, about in notes.items():
            path = run / stage / f"{part}.safetensors"
            if (made := about.get("seed")) not in (None, str(seed)):
                raise RunError(
                    f"{str(path)!r} was made with seed {made!s:.20}, and run.json says {seed}: one "
                    "of them is of another run; restore it"
                )
            if name and (made := about.get("skill")) not in (None, name):
                raise RunError(
                    f"{str(path)!r} was written with skill {made!s:.80}, not with that of "
                    f"{stage!r}: it is of another stage; restore it"
                )
        for part in MODELS:
            path, mark = run / stage / f"{part}.safetensors", notes["aside"].get(part)
            if mark is not None and path.is_file() and mark_of(path) != mark:
                raise RunError(
                    f"{str(path)!r} is not the model that was learned for {stage!r}; restore it"
                )


def _skill_name(path: Path) -> Any:
    """The name of the skill in a file; None if there is none that can be read."""
    with suppress(CgtorchError):
        data = read_json(path)
        return data.get("name") if isinstance(data, dict) else None
    return None
