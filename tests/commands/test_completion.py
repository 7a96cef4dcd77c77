"""Completion in a real bash, which has read what `--completion bash` prints."""

import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from own_domains import OWN_CART
from test_all_commands import COMMANDS

from cgtorch.commands.completion import SCENARIOS, SHELLS, STAGES, script
from cgtorch.runs.stored_run import AUTO
from cgtorch.tabletop.domain import Tabletop

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a run in runs/ and a skill file, and the commands of this tree."""
    (tmp_path / "runs").mkdir()
    shutil.copytree(REFERENCE, tmp_path / "runs" / "one")
    (tmp_path / "mine.json").write_text("{}")
    (tmp_path / "own_cart.py").write_text(OWN_CART)
    (tmp_path / "bin").mkdir()
    for name, place in COMMANDS.items():
        path = tmp_path / "bin" / name
        module = place.partition(":")[0]
        path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n')
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return tmp_path


def completed(folder: Path, line: str) -> list[str]:
    """What bash offers for the last word of a line, by the way it takes for a Tab."""
    words = line.split(" ")
    ended = subprocess.run(
        ["/bin/bash", "--norc", "-c", ASK, words[0], *words],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env={"PATH": f"{folder / 'bin'}:/usr/bin:/bin", "PYTHONPATH": ":".join(sys.path)},
    )
    assert ended.stderr == ""
    return ended.stdout.splitlines()


ASK = r"""
eval "$(cgtorch-train --completion bash)"
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
said=$(complete -p "$1")
function=${said##*-F }
compopt() { printf '%s %s\n' "$1" "$2"; }  # which has no effect but at a prompt
"${function%% *}" "$1" "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
printf '%s\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("cgtorch-train --st", ["--stage"]),
        ("cgtorch-train --stage ", list(STAGES)),
        ("cgtorch-train --stage a", ["auto"]),
        ("cgtorch-train --method ", ["compose", "paper"]),
        ("cgtorch-train --domain ", ["gymnasium", "tabletop"]),
        ("cgtorch-train --domain t", ["tabletop"]),
        ("cgtorch-train --domain tabletop --stage S", ["S0", "S1", "S2", "S3"]),
        ("cgtorch-train --domain tabletop --percept ", ["auto", "box", "yaw"]),
        ("cgtorch-train --scenarios ", list(SCENARIOS)),
        ("cgtorch-train --resume runs/one --scenarios gen", ["general", "general-clutter"]),
        ("cgtorch-train --domain own_cart:Cart --stage ", ["up", "down", "auto"]),
        ("cgtorch-train --domain own_cart:Cart --scenarios ", ["calm", "windy"]),
        ("cgtorch-train --domain own_cart:Cart --wi", ["--wind"]),
        ("cgtorch-train --domain own_cart:Cart --colour ", ["red", "blue"]),
        ("cgtorch-train --domain own_cart:Cart --percept ", []),
        ("cgtorch-train --domain nowhere --stage ", []),
        ("cgtorch-train --domain nowhere --scenarios ", []),
        ("cgtorch-evaluate runs/one --domain ", ["gymnasium", "tabletop"]),
        ("cgtorch-export runs/one --domain g", ["gymnasium"]),
        ("cgtorch-report runs/one --domain g", ["gymnasium"]),
        ("cgtorch-train --resume ", ["runs/one"]),
        ("cgtorch-train --resume runs/o", ["runs/one"]),
        ("cgtorch-train --resume ./runs/o", ["./runs/one"]),
        ("cgtorch-train --resume {folder}/runs/", ["{folder}/runs/one"]),
        ("cgtorch-train --resume runs/one/", ["-o dirnames"]),
        ("cgtorch-train --resume runs/*", ["-o dirnames"]),
        ("cgtorch-train --resume mi", ["-o dirnames"]),
        ("cgtorch-evaluate ", ["runs/one"]),
        ("cgtorch-evaluate mi", ["-o default"]),
        ("cgtorch-evaluate runs/one --skill ", ["S0", "S1", "S2", "S3"]),
        ("cgtorch-evaluate runs/one --scenarios gen", ["general", "general-clutter"]),
        ("cgtorch-export runs/one --format m", ["module", "mermaid"]),
        ("cgtorch-export --no-such", []),
    ],
)
def test_what_bash_offers(folder: Path, line: str, offered: list[str]) -> None:
    words = completed(folder, line.format(folder=folder))
    assert [word for word in words if word] == [word.format(folder=folder) for word in offered]


@pytest.mark.parametrize("shell", SHELLS)
def test_one_script_is_for_all_commands(shell: str) -> None:
    text = script(shell)
    for name in ("cgtorch-train", "cgtorch-evaluate", "cgtorch-export"):
        assert f"_{name.replace('-', '_').upper()}_COMPLETE=" in text


def test_declared_actions(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import EntryPoint, EntryPoints

    from cgtorch.commands import completion, train

    declared = EntryPoints([EntryPoint("Wait", "a:Wait", "cgtorch.actions")])
    monkeypatch.setattr(completion, "entry_points", lambda group: declared.select(group=group))
    (option,) = (p for p in train.command.params if p.name == "actions")
    context = train.command.make_context("cgtorch-train", [], resilient_parsing=True)
    assert [item.value for item in option.shell_complete(context, "W")] == ["Wait"]
    assert option.shell_complete(context, "X") == []


def test_the_words_are_those_that_the_library_knows() -> None:
    assert set(SCENARIOS) == set(Tabletop.kinds)
    assert len(SCENARIOS) == len(Tabletop.kinds)
    assert (*Tabletop.stages, AUTO) == STAGES
