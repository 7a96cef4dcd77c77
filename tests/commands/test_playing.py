"""What a query of the page of `cgtorch-view` wishes for, and runs that it cannot show."""

from pathlib import Path
from typing import Any

import pytest
from command_line import VIEW, Shell
from support import circle

from cgtorch.commands.playing import wished
from cgtorch.domains.registry import make_domain
from cgtorch.graphs import save_skill
from cgtorch.report.episode_page import Wish

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
