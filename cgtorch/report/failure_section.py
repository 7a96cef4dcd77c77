"""The section of a page that shows where a skill fails."""

from base64 import b64encode
from typing import Any

import torch
from markupsafe import Markup

from cgtorch.domains.domain import Domain
from cgtorch.domains.failures import Explained, Failure
from cgtorch.domains.film import Film, animated
from cgtorch.domains.pictures import Pictures
from cgtorch.report.failure_files import films_of
from cgtorch.report.failure_words import about_kind, most_of, table_of, title_of, which_fail
from cgtorch.report.html import inline_svg

KINDS, DRAWN = 6, 3  # kinds that are shown, and those of them with a picture
FIRST, LAST = 8, 4  # steps of a way that are shown
FILMED, MOST_FILMED = 240, 600_000  # px, and bytes, of a film


def failure_section(why: Explained, domain: Domain[Any], pictures: Pictures[Any]) -> dict[str, Any]:
    """The contents of the section."""
    found, films = why.found, dict[int, str]()
    if why.skill is not None:
        drawn = films_of(found, why.skill, domain, why.scenarios, FILMED, DRAWN)
        films = {number: url for number, film in drawn if (url := _as_url(film))}
    return {
        "which": which_fail(found),
        "blame": found.blame,
        "advice": found.advice,
        "looked": most_of(found),
        "seed": why.seed,
        "kind": next((each.kind for each in found.tried if each.tried > each.succeeded), ""),
        "more": max(0, len(found.kinds) - KINDS),
        "films": bool(films),
        "kinds": [
            {
                "title": title_of(kind),
                "count": len(kind.scenarios),
                "about": about_kind(found, kind, domain),
                "rows": table_of(kind.way, domain, FIRST, LAST),
                "film": films.get(number, ""),
                "map": _map_of(number, kind, why, pictures)
                if not films and number <= DRAWN
                else "",
            }
            for number, kind in enumerate(found.kinds[:KINDS], 1)
        ],
    }


def _as_url(film: Film) -> str:
    """A film as a URL; "" if it is too large for a page."""
    data = animated([film], "webp")
    return "" if len(data) > MOST_FILMED else "data:image/webp;base64," + b64encode(data).decode()


def _map_of(number: int, kind: Failure, why: Explained, pictures: Pictures[Any]) -> Markup:
    """A picture of what the skill solves and of what fails in this way; empty if there is none."""
    assert why.succeeded is not None  # noqa: S101  there is a kind of failure
    shown = why.succeeded.clone()
    shown[list(kind.scenarios)] = True
    good, none = why.succeeded[shown], torch.zeros(int(shown.sum()), dtype=torch.bool)
    if (figure := pictures.scenarios(why.scenarios[shown], good, none)) is None:
        return Markup("")
    for axes in figure.axes[:1]:
        axes.set_title("")
    return inline_svg(figure, f"failures-{number}", f"The scenarios of failure {number}")
