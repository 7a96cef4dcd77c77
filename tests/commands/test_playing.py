"""What a query of the page of `cgtorch-view` wishes for, and runs that it cannot show."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import VIEW, Shell
from rewarded_cart import RewardedCart
from support import circle

from cgtorch import DomainSettings
from cgtorch.commands.playing import play, wished
from cgtorch.domains.registry import make_domain
from cgtorch.graphs import save_skill
from cgtorch.ground.errors import SettingsError, WorldError
from cgtorch.report import episode_page, episode_server
from cgtorch.report.episode_page import Wish
from cgtorch.runs.chosen import Chosen
from cgtorch.training.evaluate import drawn

USUAL = Wish("b", "near", 1, 5)


@pytest.mark.parametrize(
    ("query", "wish"),
    [
        ({}, USUAL),
        ({"skill": "1", "scenarios": "far", "number": "9", "seed": "0"}, Wish("a", "far", 9, 0)),
        ({"number": "0", "seed": "-4", "skill": "0"}, Wish("a", "near", 1, 0)),
        ({"number": "11", "seed": "9999999999", "skill": "7"}, Wish("b", "near", 10, 2**31 - 1)),
        ({"number": "x", "seed": "1e9", "skill": "", "scenarios": "<b>"}, USUAL),
    ],
)
def test_a_query_is_kept_within_what_there_is(query: dict[str, str], wish: Wish) -> None:
    assert wished(query, USUAL, ["a", "b"], ("near", "far"), 10) == wish


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--against", "x.json"], "--against and --world are for the tabletop; leave them out"),
        (["--world", "mujoco"], "--against and --world are for the tabletop; leave them out"),
        (["--scenarios", "moon"], "scenarios is 'moon'; use one of any"),
        (["--host", "no host"], "host 'no host' cannot be listened on"),
    ],
)
def test_bad_input_about_another_domain(
    shell: Shell, tmp_path: Path, words: list[Any], message: str
) -> None:
    path = tmp_path / "cart.json"
    save_skill(path, circle(make_domain("examples.cart:Cart").actions(), "Test"))
    assert message in shell.refuses(VIEW, path, "--domain", "examples.cart:Cart", *words)


def test_the_scenario_that_is_wished_for_is_played(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what cannot be drawn is said on the page."""
    cart = RewardedCart(DomainSettings())
    skill = circle(cart.actions(), "Linear", "Step")
    served, met = list[Any](), list[Any]()

    @contextmanager
    def serving(host: str, port: int) -> Iterator[Any]:
        yield f"http://{host}:{port}", "waiting"

    monkeypatch.setattr(episode_server, "serving", serving)
    monkeypatch.setattr(episode_server, "answer_for_ever", lambda *given: served.extend(given))
    episode_of = episode_page.episode_of

    def watched(skill: Any, domain: Any, scenario: Any, judge: Any) -> Any:
        met.append(scenario.place.tolist())
        if len(met) == 5:
            raise WorldError("no such world; choose another")
        return episode_of(skill, domain, scenario, judge)

    monkeypatch.setattr(episode_page, "episode_of", watched)
    play(Chosen(skill, cart, cart.kinds[0]), 5, 7, "localhost", 80)
    waiting, pages = served
    assert waiting == "waiting"
    first = drawn(skill, cart, cart.kinds[0], 5, 7).place.tolist()
    for number in (1, 2, 5):
        assert b"circle" in pages({"number": str(number)})
    pages({"number": "3", "seed": "8"})
    again = drawn(skill, cart, cart.kinds[0], 5, 8).place.tolist()
    assert met == [[first[0]], [first[1]], [first[4]], [again[2]]]
    assert b"no such world; choose another" in pages({})


def test_a_robot_is_not_played(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episode_server, "serving", lambda *given: pytest.fail("it is served"))

    class Robot(RewardedCart):
        def world(self, scenarios: Any) -> Any:
            live = dict.fromkeys(("told", "recall", "ended"), print)
            return SimpleNamespace(**live, percept_size=2, control_size=1, num_scenarios=1)

    skill = circle(RewardedCart(DomainSettings()).actions(), "Linear", "Step")
    robot = Robot(DomainSettings())
    chosen = Chosen(skill, robot, robot.kinds[0])
    with pytest.raises(SettingsError, match="a robot is watched where it stands; give a run in a"):
        play(chosen, 1, 0, "localhost", 80)
