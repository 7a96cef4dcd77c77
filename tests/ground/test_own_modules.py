"""Modules of the user's own that act as programs, or belong to packages, are told so."""

import sys
from argparse import ArgumentParser
from importlib import import_module
from pathlib import Path

import pytest

from cgtorch.domains.registry import domain_class
from cgtorch.ground.errors import DomainError
from cgtorch.ground.own_modules import as_module

PARSES = """import argparse
parser = argparse.ArgumentParser()
parser.add_argument("--lr")
parser.parse_args()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("parses", "leaves", "part"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def test_a_module_that_reads_the_command_line_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "parses.py").write_text(PARSES)
    monkeypatch.setattr(sys, "argv", ["cgtorch-train", "--domain", "parses:Cart"])
    before = ArgumentParser.error
    with pytest.raises(DomainError) as caught:
        domain_class("parses:Cart")
    assert str(caught.value) == (
        "line 4 of parses.py reads the command line, which is that of cgtorch; let it do so only "
        "where it is the program (if __name__ == '__main__')"
    )
    assert capsys.readouterr() == ("", "")
    assert ArgumentParser.error is before
    monkeypatch.setattr(sys, "argv", ["cgtorch-train", "--lr", "1"])
    assert as_module(lambda: import_module("parses")).parser.parse_args([]).lr is None


def test_words_that_a_module_gives_itself_are_its_own(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    own = PARSES.replace(
        "parser.parse_args", "import sys; sys.argv = ['x', '--no']; parser.parse_args"
    )
    (folder / "parses.py").write_text(own)
    monkeypatch.setattr(sys, "argv", ["cgtorch-train"])
    with pytest.raises(DomainError, match=r"raised SystemExit: 2 in line 4 of parses\.py; let it"):
        as_module(lambda: import_module("parses"))
    assert "unrecognized arguments: --no" in capsys.readouterr().err


def test_a_module_that_ends_the_program_is_told(folder: Path) -> None:
    (folder / "leaves.py").write_text("raise SystemExit('done')")
    with pytest.raises(DomainError, match=r"raised SystemExit: done in line 1 of leaves\.py; let"):
        domain_class("leaves:Cart")


def test_a_part_of_a_package_is_to_be_called_from_above(folder: Path) -> None:
    (folder / "part.py").write_text("from .other import x")
    with pytest.raises(DomainError, match=r"line 1 of part\.py; .*folder above, .*package\.module"):
        domain_class("part:Cart")
