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
from command_line import ROOT, Shell
from own_domains import EXAMPLE

COMMANDS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "scripts"
]
SLOW = {"torch", "numpy", "onnx", "jinja2"}


def command_of(name: str) -> click.Command:
    command = import_module(COMMANDS[name].partition(":")[0]).command
    assert isinstance(command, click.Command)
    return command


def options_of(name: str) -> list[click.Option]:
    """All options, those of the usual domain too."""
    command = command_of(name)
    every = command.get_params(click.Context(command))
    return [option for option in every if isinstance(option, click.Option)]


@pytest.mark.parametrize(
    "words",
    [*([name] for name in COMMANDS), ["cgtorch-train", "--domain", "tabletop"],
     ["cgtorch-train", "--resume", "none"]],
)  # fmt: skip
def test_help_is_there_in_less_than_a_second_without_slow_imports(words: list[str]) -> None:
    module, _, function = COMMANDS[words[0]].partition(":")
    code = (
        f"import atexit, sys; sys.argv = {[*words, '--help']!r}\n"
        f"atexit.register(lambda: print({SLOW!r} & set(sys.modules), file=sys.stderr))\n"
        f"from {module} import {function}; {function}()"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (ended.returncode, ended.stderr) == (0, "set()\n")
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 1
    examples = ended.stdout.partition("\n  Examples:\n")[2].partition("\n\n")[0].splitlines()
    assert len(examples) > 1
    assert any(line.split()[0] == words[0] for line in examples)
    assert "\n  Exit codes: 0 " in ended.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_options_that_name_code_let_it_be_imported_from_here(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = ("actions",) if name == "cgtorch-train" else ("actions", "domain")
    for option in options_of(name):
        if option.name not in named:
            continue
        monkeypatch.setattr(sys, "path", ["elsewhere"])
        assert option.callback is not None
        context = click.Context(command_of(name))
        for given, path in (("tabletop", ["elsewhere"]), ("mine:Own", ["", "elsewhere"])):
            value = (given,) if option.multiple else given
            with suppress(click.UsageError):  # there is no such module
                option.callback(context, option, value)
            assert sys.path == path


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_help(name: str) -> None:
    for option in options_of(name):
        assert option.help, option.name


@pytest.fixture
def my_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package that examples speak of."""
    (tmp_path / "my_package").mkdir()
    (tmp_path / "my_package" / "cart.py").write_text(EXAMPLE)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_are_understood(name: str, my_package: None) -> None:
    """Every option of an example is one that the command has, with a value that it takes."""
    for line in (command_of(name).epilog or "").splitlines():
        words = shlex.split(line.partition("|")[0].partition("&&")[0].replace("'", ""))
        if words[:1] == [name]:
            with suppress(click.exceptions.Exit):  # after --help
                command_of(name).make_context(name, words[1:], resilient_parsing=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_it_runs_as_a_module_and_says_its_version(name: str) -> None:
    module = COMMANDS[name].partition(":")[0]
    ended = subprocess.run(
        [sys.executable, "-m", module, "--version"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert ended.stderr == ""
    assert ended.stdout.startswith(f"{name}, version ")


@pytest.mark.parametrize("name", COMMANDS)
def test_its_options_say_what_they_are_for_and_others_are_refused(name: str, shell: Shell) -> None:
    assert f"; see {name} --help" in shell.refuses(name, "--no-such-option")
    assert [option.name for option in options_of(name) if not option.help] == []
    usual = {"--version", "--completion"} | ({"--quiet"} if name != "cgtorch" else set())
    assert usual <= {word for option in options_of(name) for word in option.opts}


def test_cgtorch_alone_lists_all_commands(shell: Shell) -> None:
    alone = shell.does("cgtorch")
    assert alone == shell.does("cgtorch", "--help")
    listed = alone.out.partition("\nCommands:\n")[2].partition("\n\n")[0].splitlines()
    names = [line.split()[0] for line in listed if line.startswith("  ") and line[2] != " "]
    assert names == sorted(name.removeprefix("cgtorch-") for name in COMMANDS if "-" in name)
    assert all(len(line.split()) > 1 for line in listed)


def test_a_command_has_two_names(shell: Shell) -> None:
    own, short = (shell.does(*n, "--help") for n in (["cgtorch-evaluate"], ["cgtorch", "evaluate"]))
    assert short.out == own.out.replace("cgtorch-evaluate [", "cgtorch evaluate [", 1)
    refused = shell("cgtorch", "evaluate", "--no-such-option")
    assert refused.code == 2
    assert refused.err.startswith("cgtorch evaluate: ")
    assert shell.refuses("cgtorch", "fly") == (
        "cgtorch: No such command 'fly'; see cgtorch --help\n"
    )


def test_an_option_is_of_one_kind_in_all_commands() -> None:
    kinds: dict[str, tuple[object, ...]] = {}
    for name in COMMANDS:
        for option in options_of(name):
            kind = option.type.name.removesuffix(" range"), option.nargs, option.multiple
            for word in option.opts:
                assert kinds.setdefault(word, kind) == kind, f"{word} of {name}"
