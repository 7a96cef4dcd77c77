"""Why a skill fails, as files, and films of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cgtorch.domains.domain import Domain
from cgtorch.domains.failures import Failures
from cgtorch.domains.film import WIDTH, Film, animated
from cgtorch.graphs import Skill
from cgtorch.ground.errors import CgtorchError
from cgtorch.ground.files import write_bytes, write_json
from cgtorch.report.failure_words import as_data, as_text


def films_of(
    found: Failures,
    skill: Skill,
    domain: Domain[Any],
    scenarios: Any,
    width: int = WIDTH,
    most: int | None = None,
) -> Iterator[tuple[int, Film]]:
    """Films of the examples of the first kinds, with their numbers from 1, until one has none."""
    pictures = domain.pictures(domain)
    for number, kind in enumerate(found.kinds[:most], 1):
        try:
            film = pictures.film(skill, scenarios[kind.scenarios[0] : kind.scenarios[0] + 1], width)
        except CgtorchError:  # this machine cannot draw, and to try again may end the process
            return
        if film is None:
            return
        yield number, film


def write_failures(
    folder: Path, found: Failures, skill: Skill, domain: Domain[Any], scenarios: Any
) -> list[Path]:
    """Write failures.md, failures.json, and a film of each kind where the domain can draw.

    `scenarios` are those whose numbers `found` has.
    """
    folder.mkdir(parents=True, exist_ok=True)
    films = dict[int, str]()
    for number, film in films_of(found, skill, domain, scenarios):
        films[number] = f"kind-{number}.webp"
        write_bytes(folder / films[number], animated([film], "webp"))
    data = as_data(found, domain)
    for number, kind in enumerate(data["kinds"], 1):
        kind["film"] = films.get(number)
    write_json(folder / "failures.json", data)
    write_bytes(folder / "failures.md", as_text(found, domain, films).encode())
    return [folder / name for name in ("failures.md", "failures.json", *films.values())]
