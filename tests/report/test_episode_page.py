"""What the page of an episode has: pictures with their steps, or why there are none."""

import json
from typing import Any

import numpy as np
import pytest
from lxml import html
from members import nearly
from reaching import TABLE, small_knowledge
from support import circle, seeded

from cgtorch.domains.domain import Domain
from cgtorch.domains.film import Film
from cgtorch.domains.registry import make_domain
from cgtorch.domains.way import Judge
from cgtorch.ground.errors import SettingsError
from cgtorch.report.episode_page import (
    UNKNOWN,
    Episode,
    Wish,
    acts_of,
    data_of,
    episode_of,
    episode_page,
)

SKILL = nearly(0.25)
JUDGE = Judge(None, TABLE.percept)


def film_of(count: int, acts: tuple[int, ...] = ()) -> Film:
    return Film([np.full((4, 6, 3), 9 * i, np.uint8) for i in range(count)], 50, "failure", acts)


def episode(domain: Domain[Any] = TABLE, judge: Judge = JUDGE) -> Episode:
    return episode_of(SKILL, domain, domain.draw("perimeter", 1, seeded(0)), judge)


def test_steps_have_nodes_percepts_and_controls_with_names_and_units() -> None:
    one = episode(judge=Judge(small_knowledge(), TABLE.percept))
    data = data_of(one, TABLE)
    acts = one.way.acts
    assert len(data["steps"]) == len(acts) + 1
    assert data["acts"] == [*range(-1, len(acts))]
    assert data["frames"] == []
    for step, act in zip(data["steps"][1:], acts, strict=True):
        assert step["node"] == f"{act.node} → {act.outcome}"
        assert step["percept"][4] == ("object x", f"{float(act.percept[4]):.3g} m")
        names = [name for name, _ in step["about"]]
        assert ("dx" in names) == bool(act.motions or act.refused is not None)
        assert ("refused" in names) == (act.refused is not None)
        assert ("C says", f"{act.chance:.2f}") in step["about"]
        assert ("Γ errs" in names) == bool(act.motions)


def test_a_picture_belongs_to_the_act_during_which_it_was_taken() -> None:
    pytest.importorskip("PIL")
    way = episode().way
    known, each = film_of(4, (0, 1, 1, 3)), film_of(len(way.acts) + 1)
    assert [*acts_of(known, way)] == [-1, 1, 1, 3]
    assert [*acts_of(each, way)] == [*range(-1, len(way.acts))]
    assert [*acts_of(film_of(3), way)] == []
    data = data_of(Episode(way, known, ""), TABLE)
    assert len(set(data["frames"])) == 4
    assert all(url.startswith("data:image/webp;base64,") for url in data["frames"])
    assert data["lasts"] == 50


def test_it_says_why_there_are_no_pictures_or_no_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    assert episode().remark == "This domain draws no pictures (Pictures.film)."

    def drawn(*given: Any) -> Any:
        return film_of(3)

    monkeypatch.setattr(TABLE.pictures, "film", drawn)
    assert episode().remark == UNKNOWN
    monkeypatch.setattr(TABLE, "repeats", False)
    assert episode().remark.startswith("This world does not repeat itself")

    def fails(*given: Any) -> Any:
        raise SettingsError("MuJoCo cannot draw here")

    monkeypatch.setattr(TABLE.pictures, "film", fails)
    assert episode().remark == "There are no pictures: MuJoCo cannot draw here."


def test_films_of_gymnasium_know_their_acts() -> None:
    pytest.importorskip("pygame")
    domain = make_domain("gymnasium:CartPole-v1")
    skill = circle(domain.actions(), "Linear", "Step")
    scenario = domain.draw("starts", 1, seeded(0))
    film = domain.pictures(domain).film(skill, scenario, 60)
    assert film is not None
    assert len(film.acts) == len(film.frames)
    assert film.acts[0] == 0
    assert [*film.acts] == sorted(film.acts)
    assert all(act % 2 for act in film.acts[1:]), "which are those of Step"
    way = episode_of(skill, domain, scenario, Judge(None, domain.percept)).way
    assert film.acts[-1] == len(way.acts) - 1


def test_the_page_holds_its_data_and_what_can_be_chosen() -> None:
    wish = Wish("</script><b>", "far", 3, 7)
    page = html.document_fromstring(
        episode_page(wish, episode(), TABLE, ["</script><b>", "other"], 50).decode()
    )
    data = json.loads(page.get_element_by_id("data").text)
    assert data == json.loads(json.dumps(data_of(episode(), TABLE)))
    chosen = [option.text for option in page.iter("option") if option.get("selected") is not None]
    assert chosen == ["</script><b>", "far"]
    assert page.find(".//input[@name='number']").get("max") == "50"
    assert [*page.iter("b")] == []
    assert page.find(".//h1").text == f"</script><b> ends in {episode().way.end}"
    refused = episode_page(wish, None, TABLE, ["x"], 50, "no such <b>").decode()
    assert "Not run: no such &lt;b&gt;" in refused
    assert "<script" not in refused
