"""What every command keeps to, those that come later too: help, version, options, exit codes."""

import os
import resource
import shlex
import subprocess
import sys
import tomllib
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import click
import pytest
from own_domains import EXAMPLE

ROOT = Path(__file__).parents[2]
COMMANDS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "scripts"
]


def command_of(name: str) -> click.Command:
    command = import_module(COMMANDS[name].partition(":")[0]).command
    assert isinstance(command, click.Command)
    return command


def parameters_of(name: str) -> list[click.Parameter]:
    """All parameters, those of the usual domain too."""
    command = command_of(name)
    return command.get_params(click.Context(command))


def run(name: str, *words: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """Run the command as its installed script does; also the CPU seconds that took."""
    module, _, function = COMMANDS[name].partition(":")
    code = f"import sys; from {module} import {function}; sys.argv[0] = {name!r}; {function}()"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False, cwd=ROOT
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return ended, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_there_in_less_than_a_second(name: str) -> None:
    ended, seconds = run(name, "--help")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert seconds < 1
    examples = ended.stdout.partition("\n  Examples:\n")[2].partition("\n\n")[0].splitlines()
    assert len(examples) > 1
    assert any(line.split()[0] == name for line in examples)
    assert "\n  Exit codes: 0 " in ended.stdout


@pytest.fixture
def my_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package that examples speak of."""
    (tmp_path / "my_package").mkdir()
    (tmp_path / "my_package" / "cart.py").write_text(EXAMPLE)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_are_understood(name: str, my_package: None) -> None:
    """Every option of an example is one that the command has, with a value that it takes."""
    lines = (command_of(name).epilog or "").splitlines()
    for line in lines:
        words = shlex.split(line.partition("|")[0].partition("&&")[0].replace("'", ""))
        if words[:1] == [name]:
            with suppress(click.exceptions.Exit):  # after --help
                command_of(name).make_context(name, words[1:], resilient_parsing=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_version(name: str) -> None:
    ended, _ = run(name, "--version")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith(f"{name}, version ")


@pytest.mark.parametrize("name", COMMANDS)
def test_an_unknown_option_is_bad_input(name: str) -> None:
    ended, _ = run(name, "--no-such-option")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.count("\n") == 1
    assert f"; see {name} --help" in ended.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_is_for(name: str) -> None:
    options = [p for p in parameters_of(name) if isinstance(p, click.Option)]
    assert [option.name for option in options if not option.help] == []
    usual = {"--version", "--completion"} | ({"--quiet"} if name != "cgtorch" else set())
    assert usual <= {o for p in options for o in p.opts}


def test_cgtorch_alone_lists_all_commands() -> None:
    alone, asked = run("cgtorch")[0], run("cgtorch", "--help")[0]
    assert (alone.returncode, alone.stderr) == (0, "")
    assert alone.stdout == asked.stdout
    listed = alone.stdout.partition("\nCommands:\n")[2].partition("\n\n")[0].splitlines()
    names = [line.split()[0] for line in listed if line.startswith("  ") and line[2] != " "]
    assert names == sorted(name.removeprefix("cgtorch-") for name in COMMANDS if "-" in name)
    assert all(len(line.split()) > 1 for line in listed)


def test_a_command_has_two_names() -> None:
    own, short = run("cgtorch-evaluate", "--help")[0], run("cgtorch", "evaluate", "--help")[0]
    assert short.stdout == own.stdout.replace("cgtorch-evaluate [", "cgtorch evaluate [", 1)
    refused = run("cgtorch", "evaluate", "--no-such-option")[0]
    assert refused.returncode == 2
    assert refused.stderr.startswith("cgtorch evaluate: ")
    unknown = run("cgtorch", "fly")[0]
    assert unknown.returncode == 2
    assert unknown.stderr == "cgtorch: No such command 'fly'; see cgtorch --help\n"


def test_an_option_is_of_one_kind_in_all_commands() -> None:
    kinds: dict[str, tuple[object, ...]] = {}
    for name in COMMANDS:
        for option in parameters_of(name):
            kind = option.type.name.removesuffix(" range"), option.nargs, option.multiple
            for word in option.opts if isinstance(option, click.Option) else []:
                assert kinds.setdefault(word, kind) == kind, f"{word} of {name}"


@pytest.mark.parametrize("name", COMMANDS)
def test_it_runs_as_a_module(name: str) -> None:
    module = COMMANDS[name].partition(":")[0]
    ended = subprocess.run(
        [sys.executable, "-m", module, "--version"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert ended.stdout.startswith(f"{name}, version ")
