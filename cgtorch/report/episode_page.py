"""A page on which a skill acts on one scenario, picture by picture, with what it does beside."""

import io
import json
import secrets
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from markupsafe import Markup

from cgtorch.domains.domain import Domain
from cgtorch.domains.film import Film, pillow
from cgtorch.domains.way import Judge, Way, way_of
from cgtorch.graphs import Skill
from cgtorch.ground.errors import CgtorchError, printable
from cgtorch.report.failure_words import in_unit, named, said_of
from cgtorch.report.html import templates

PACKAGE, WIDTH, QUALITY = "cgtorch.report", 560, 70


@dataclass(frozen=True)
class Wish:
    """What to play: a skill by its name, and a scenario, number 1 being the first of its kind."""

    skill: str
    kind: str
    number: int
    seed: int


@dataclass(frozen=True, eq=False)
class Episode:
    """What a skill does on a scenario, its film if there is one, and why there is none."""

    way: Way
    film: Film | None
    remark: str


def episode_of(skill: Skill, domain: Domain[Any], scenario: Any, judge: Judge) -> Episode:
    """A skill on one scenario; what cannot be drawn is told in the remark."""
    way = way_of(skill, domain.world(scenario), judge)
    try:
        film = domain.pictures(domain).film(skill, scenario, WIDTH)
    except CgtorchError as e:
        return Episode(way, None, f"There are no pictures: {e}.")
    if film is None:
        return Episode(way, None, "This domain draws no pictures (Pictures.film).")
    if not domain.repeats:
        return Episode(
            way, film, "This world does not repeat itself: the steps are of a second try."
        )
    return Episode(way, film, "" if acts_of(film, way) else UNKNOWN)


UNKNOWN = "The domain does not say which picture belongs to which step (Film.acts)."


def acts_of(film: Film, way: Way) -> Sequence[int]:
    """The act of each picture, -1 before the first one; () if that is not known."""
    if film.acts:
        return [-1, *film.acts[1:]]
    each = len(film.frames) == len(way.acts) + 1
    return range(-1, len(way.acts)) if each else ()


def episode_page(
    wish: Wish,
    episode: Episode | None,
    domain: Domain[Any],
    skills: Sequence[str],
    count: int,
    refused: str = "",
) -> bytes:
    """The page as UTF-8, with a script of its own and nothing from elsewhere.

    Without an episode it shows why what was wished for is `refused`.
    """
    script, style = (
        (files(PACKAGE) / "templates" / name).read_text() for name in ("episode.js", "episode.css")
    )
    template = templates(PACKAGE).get_template("episode.html")
    return template.render(
        wish=wish,
        skills=skills,
        kinds=domain.kinds,
        count=count,
        refused=refused,
        remark=episode.remark if episode else "",
        end=episode.way.end if episode else "",
        data=_as_json(data_of(episode, domain)) if episode else "",
        nonce=secrets.token_urlsafe(16),
        script=Markup(script),  # noqa: S704  our own file
        style=Markup(style),  # noqa: S704  our own file
    ).encode()


def data_of(episode: Episode, domain: Domain[Any]) -> dict[str, Any]:
    """What the page's script shows: pictures, ms that each lasts, their acts, and all steps."""
    way, film = episode.way, episode.film
    steps = [{"node": "start", "about": [], "percept": _rows(way.first, domain.percept)}]
    for act in way.acts:
        chance, error = said_of(act)
        controls = [row for m in act.motions for row in _rows(m.control, domain.control)]
        if act.refused is not None:
            controls = [("refused", ""), *_rows(act.refused, domain.control)]
        said = [("C says", chance), ("Γ errs", error)]
        about = [*controls, *(row for row in said if row[1])]
        node, percept = printable(f"{act.node} → {act.outcome}"), _rows(act.percept, domain.percept)
        steps.append({"node": node, "about": about, "percept": percept})
    if film is None:
        return {"frames": [], "lasts": 400, "acts": [*range(-1, len(way.acts))], "steps": steps}
    frames = [_as_url(frame) for frame in film.frames]
    return {"frames": frames, "lasts": film.lasts, "acts": [*acts_of(film, way)], "steps": steps}


def _rows(values: Any, fields: Any) -> list[tuple[str, str]]:
    """Names and values with units."""
    known = zip(named(fields, len(values)), values.tolist(), strict=True)
    return [(name, in_unit(value, unit)) for (name, unit), value in known]


def _as_url(frame: Any) -> str:
    """A picture as a URL."""
    out = io.BytesIO()
    pillow().fromarray(frame).save(out, "WEBP", quality=QUALITY)
    return "data:image/webp;base64," + b64encode(out.getvalue()).decode()


def _as_json(data: Any) -> Markup:
    """JSON in a page, in which nothing ends the element that holds it."""
    text = json.dumps(data).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Markup(text)  # noqa: S704  nothing of HTML is left
