"""The recipes of docs/recipes.md run, one after the other in one folder."""

import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parent.parent / "docs" / "recipes.md"
CODE = re.compile(r"^```python\n(?:# (\w+\.py)\n)?(.*?)^```", re.M | re.S)


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What the recipes have defined at their end, and `folder`, where they ran."""
    folder, text = tmp_path_factory.mktemp("recipes"), PAGE.read_text()
    printed = StringIO()
    names: dict[str, Any] = {"__name__": "recipes", "folder": folder, "printed": printed}
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        patch.setenv("MPLBACKEND", "agg")
        for found in CODE.finditer(text):
            name, code = found.groups()
            line = text[: found.start(2)].count("\n")  # so that an error names the page's line
            if name:
                (folder / name).write_text(code)
            else:
                exec(compile("\n" * line + code, str(PAGE), "exec"), names)  # noqa: S102
        yield names


def test_there_are_twenty_recipes() -> None:
    recipes = re.split(r"^## … ", PAGE.read_text(), flags=re.M)[1:]
    assert len(recipes) >= 20
    for recipe in recipes:
        assert "```python" in recipe or "\n    " in recipe, recipe


def test_skills_do_what_they_were_trained_for(left: dict[str, Any]) -> None:
    assert left["run"].evaluate(50, scenarios="near").successes > 40
    assert left["request"].kind == "success"
    assert left["lift"].evaluate(200).successes > 150
    assert left["logged"].evaluate(200).successes > 100


def test_runs_are_stopped_continued_and_compared(left: dict[str, Any]) -> None:
    assert "\n()\n" in left["printed"].getvalue()  # the stages of what was stopped
    assert left["finished"].stages == ("S0",)
    assert left["finished"].settings.generations == 300
    assert left["generations"].best.max() > 0.5
    assert 0 < left["motions"] <= 300
    assert {"stage", "generation", "accepted"} <= set(left["log"].event)
    assert "Creep" in left["again"].actions.names
    assert left["search"].generation == 6
    assert left["search"].best_fitness > 0
    assert left["pole"].evaluate(20).mean_return > 50
    assert left["arm"].evaluate(20).successes > 15


def test_files_are_written(left: dict[str, Any]) -> None:
    names = (
        "skill.json",
        "skill.svg",
        "machine.py",
        "skill.mmd",
        "seeds.png",
        "report.html",
        "log.csv",
    )
    for name in names:
        assert (left["folder"] / name).stat().st_size > 100, name
