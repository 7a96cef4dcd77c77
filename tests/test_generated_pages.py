"""What pages show of the code is what the code says, and names of the code are links everywhere."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tools"))

import make_reference  # noqa: E402


@pytest.mark.parametrize("page", make_reference.pages(), ids=lambda page: page.name)
def test_pages_hold_what_is_generated(page: Path) -> None:
    text = page.read_text()
    assert text.count("<!-- generated: ") - text.count(make_reference.LINKS) == text.count(
        "<!-- /generated -->"
    )
    assert make_reference.written(page, text) == text, "call `make figures`"


def test_names_lead_to_where_they_are_defined() -> None:
    page = ROOT / "docs" / "decisions" / "models.md"
    text = make_reference.written(
        page,
        "[`Run`][cgtorch.runs.stored_run.StoredRun], [`cgtorch.improvement`][], "
        "[`Lanes`][cgtorch.ground.environment.Lanes], "
        "[order][cgtorch.evolution.population.STRATEGY]\n",
    )
    found = dict(re.findall(r"^\[(.+)\]: (.+)$", text, re.MULTILINE))
    assert found == {
        "cgtorch.runs.stored_run.StoredRun": "../../cgtorch/runs/stored_run.py",
        "`cgtorch.improvement`": "../../cgtorch/improvement",
        "cgtorch.ground.environment.Lanes": "../../cgtorch/ground/environment.py",
        "cgtorch.evolution.population.STRATEGY": "../../cgtorch/evolution/population.py",
    }
    assert all((page.parent / place).exists() for place in found.values())
    assert make_reference.written(page, text) == text


def test_every_command_and_setting_is_there() -> None:
    commands, settings = (
        (ROOT / "docs" / name).read_text() for name in ("commands.md", "settings.md")
    )
    assert "\n## cgtorch-train\n" in commands
    assert "--checkpoint-seconds" in commands
    assert "\n| `max_transitions` |" in settings
