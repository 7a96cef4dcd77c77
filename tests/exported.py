"""The reference run's skill in the formats that take long, each written once by the command."""

from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner
from made_once import made_once, shared_folder

from cgtorch.commands.export import command

REFERENCE = Path(__file__).parents[1] / "runs" / "reference"
SLOW = {"module": "S3.pt2", "onnx": "S3.onnx"}


def exported(form: str, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of one of these formats, which the first process that asks for it writes."""
    folder = made_once(shared_folder(tmp_path_factory) / form, partial(_write, form))
    return (folder / SLOW[form]).read_bytes()


def _write(form: str, folder: Path) -> None:
    folder.mkdir()
    words = [str(REFERENCE), "--format", form, "--output", str(folder / SLOW[form])]
    ended = CliRunner().invoke(command, words)
    assert ended.exit_code == 0, ended.output
    assert ended.stderr == ""
    assert [path.name for path in folder.iterdir()] == [SLOW[form]]
