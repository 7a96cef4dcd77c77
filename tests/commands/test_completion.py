"""Completion: which words are offered, and a real bash that has read `--completion bash`."""

import shutil
import stat
import subprocess
import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest
from click.shell_completion import BashComplete
from command_line import REFERENCE, Shell
from own_domains import OWN_CART
from test_all_commands import COMMANDS, command_of

from cgtorch.commands import completion, train
from cgtorch.commands.completion import SCENARIOS, SHELLS, STAGES, script
from cgtorch.runs.stored_run import AUTO
from cgtorch.tabletop.domain import Tabletop

ASK = r"""
eval "$(cgtorch-train --completion bash)"
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
said=$(complete -p "$1")
function=${said##*-F }
compopt() { printf '%s %s\n' "$1" "$2"; }  # which has no effect but at a prompt
"${function%% *}" "$1" "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
printf '%s\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a run in runs/, a skill file, and a domain."""
    for part in ("run.json", *(f"S{n}/skill.json" for n in range(4))):
        place = tmp_path / "runs" / "one" / part
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REFERENCE / part, place)
    (tmp_path / "mine.json").write_text("{}")
    (tmp_path / "own_cart.py").write_text(OWN_CART)
    return tmp_path


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("cgtorch-train --st", ["--stage"]),
        ("cgtorch-train --stage ", list(STAGES)),
        ("cgtorch-train --method ", ["compose", "paper"]),
        (
            "cgtorch-train --domain ",
            ["gymnasium", "gymnasium-robotics", "metaworld", "tabletop"],
        ),
        ("cgtorch-train --domain tabletop --stage S", ["S0", "S1", "S2", "S3"]),
        ("cgtorch-train --domain tabletop --percept ", ["auto", "box", "yaw"]),
        ("cgtorch-train --scenarios ", list(SCENARIOS)),
        ("cgtorch-train --resume runs/one --scenarios gen", ["general", "general-clutter"]),
        ("cgtorch-train --domain own_cart:Cart --stage ", ["up", "down", "auto"]),
        ("cgtorch-train --domain own_cart:Cart --scenarios ", ["calm", "windy"]),
        ("cgtorch-train --domain own_cart:Cart --wi", ["--wind"]),
        ("cgtorch-train --domain own_cart:Cart --colour ", ["red", "blue"]),
        ("cgtorch-train --domain nowhere --stage ", []),
        ("cgtorch-report runs/one --domain g", ["gymnasium", "gymnasium-robotics"]),
        ("cgtorch-train --resume ", ["runs/one"]),
        ("cgtorch-train --resume ./runs/o", ["./runs/one"]),
        ("cgtorch-train --resume {folder}/runs/", ["{folder}/runs/one"]),
        ("cgtorch-train --resume runs/one/", ["-o dirnames"]),
        ("cgtorch-train --resume runs/*", ["-o dirnames"]),
        ("cgtorch-evaluate ", ["runs/one"]),
        ("cgtorch-evaluate mi", ["-o default"]),
        ("cgtorch-evaluate runs/one --skill ", ["S0", "S1", "S2", "S3"]),
        ("cgtorch-evaluate runs/one --scenarios gen", ["general", "general-clutter"]),
        ("cgtorch-export runs/one --format m", ["module", "mermaid"]),
        ("cgtorch-export --no-such", []),
    ],
)
def test_what_is_offered(
    folder: Path, shell: Shell, monkeypatch: pytest.MonkeyPatch, line: str, offered: list[str]
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    name, *words, last = line.format(folder=folder).split(" ")
    asked = BashComplete(command_of(name), {}, name, "")
    kinds = {"dir": "-o dirnames", "file": "-o default"}
    found = [kinds.get(item.type, item.value) for item in asked.get_completions(words, last)]
    assert found == [word.format(folder=folder) for word in offered]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("cgtorch-train --resume runs/one --stage ", list(STAGES)),
        ("cgtorch-train --domain own_cart:Cart --wi", ["--wind"]),
        ("cgtorch-train --resume runs/*", ["-o dirnames"]),
        ("cgtorch-evaluate mi", ["-o default"]),
    ],
)
def test_what_bash_offers(folder: Path, line: str, offered: list[str]) -> None:
    """By the way it takes for a Tab."""
    (folder / "bin").mkdir()
    for name, place in COMMANDS.items():
        path = folder / "bin" / name
        module = place.partition(":")[0]
        path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n')
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
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
    assert [word for word in ended.stdout.splitlines() if word] == offered


@pytest.mark.parametrize("shell", SHELLS)
def test_one_script_is_for_all_commands(shell: str) -> None:
    text = script(shell)
    for name in ("cgtorch-train", "cgtorch-evaluate", "cgtorch-export"):
        assert f"_{name.replace('-', '_').upper()}_COMPLETE=" in text


def test_declared_actions(monkeypatch: pytest.MonkeyPatch) -> None:
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
