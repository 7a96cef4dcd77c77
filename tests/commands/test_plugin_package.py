"""A package of somebody else's with actions, installed as any other and found by its names."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import EVALUATE, ROOT, TRAIN, Shell, about, as_options
from told_by_runs import result_of
from trained import SMALL

from cgtorch.tabletop.actions import paper_actions

SOURCE = ROOT / "tests" / "plugin_package"
NAMES = ("Approach", "Wander")
NAMED = [word for name in NAMES for word in ("--actions", name)]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder that pip has put the package into, known to commands while tests run."""
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(SOURCE, folder / "source")  # building leaves things beside the sources
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"),
            *("--no-index", "--no-deps", "--no-build-isolation"),
            *("--target", str(folder / "site"), str(folder / "source")),
        ],
        check=True,
        capture_output=True,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder / "site")
        yield folder / "site"


def test_it_holds_what_the_document_says() -> None:
    text = (ROOT / "docs" / "own-action.md").read_text()
    for name in NAMES:
        code = (SOURCE / "src" / "reaching_actions" / f"{name.lower()}.py").read_text()
        (said,) = re.findall(rf"^```python\n# {name.lower()}\.py\n(.*?)^```", text, re.M | re.S)
        assert code.partition('"""\n\n')[2] == said


def test_it_is_found_by_name(installed: Path) -> None:
    assert (installed / "reaching_actions" / "approach.py").is_file()
    program = (
        "from cgtorch import paper_actions, resolve_actions\n"
        "actions = resolve_actions(['Approach', 'Wander'], paper_actions(), (7, 3))\n"
        "print(*actions.names)\n"
        "print(actions.actions[-2].__class__.__module__)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=True,
    )
    names, module = ended.stdout.splitlines()
    assert names.split() == [*paper_actions().names, *NAMES]
    assert module == "reaching_actions.approach"


@pytest.mark.hostile
def test_a_run_is_trained_with_it_and_tried_again(
    shell: Shell, installed: Path, tmp_path: Path
) -> None:
    """It is said which of its actions the skill uses, and it is read again without naming them."""
    folder = tmp_path / "run"
    ended = shell.does(TRAIN, "--stage", "S0", "--run-dir", "run", *as_options(SMALL), *NAMED)
    assert about(folder)["settings"]["actions"] == list(NAMES)
    skill = json.loads((folder / "S0" / "skill.json").read_text())
    every = [skill, *skill["skills"].values()]
    used = {n["action"] for one in every for n in one["nodes"]}
    for name in NAMES:
        uses = f"S0 uses the action {name}.", f"No node of S0 is {name}: the search found no use"
        assert [line in ended.err for line in uses] == [name in used, name not in used]
    words = ["--scenarios", "near", "--count", "40", "--seed", "5"]
    found = shell.told(EVALUATE, "run", *words)
    assert (found["skill"], found["tried"]) == ("S0", 40)
    assert found["succeeded"] > 20
    assert result_of(folder, "S0")["targets_succeeded"] > 2
    alone = shell.told(EVALUATE, "run/S0/skill.json", *words, *NAMED)
    assert alone["succeeded"] == found["succeeded"]
    shell.monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(installed)])
    assert "unknown action 'Approach'; known are" in shell.refuses(EVALUATE, "run")
