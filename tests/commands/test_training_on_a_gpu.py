"""`cgtorch-train --device cuda` to its end, where tensors say that they are on a GPU."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner
from command_line import as_options
from pretended_gpu import pretended_gpu
from trained import SMALL

from cgtorch.commands.train import command
from cgtorch.commands.training import device_of
from cgtorch.ground.files import read_json

OPTIONS = as_options(replace(SMALL, practice=0))


def test_a_skill_is_evolved_there(tmp_path: Path) -> None:
    where = ["--stage", "S0", "--run-dir", str(tmp_path / "run"), "--device", "cuda", "--quiet"]
    with pretended_gpu() as gpu:
        ended = CliRunner().invoke(command, [*where, *OPTIONS])
    assert ended.exit_code == 0, ended.output
    assert gpu.waits["rollout.py: _grouped"] > 20  # rollouts were there
    (stage,) = read_json(tmp_path / "run" / "summary.json")["stages"]
    assert stage["generations"] > 0
    assert stage["transitions"] > 0


def test_the_fastest_device_is_the_cpu_and_said_where_there_is_a_gpu(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for there, says in ((False, ""), (True, "device: cpu, which is faster here")):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        assert device_of("auto") == torch.device("cpu")
        told = capsys.readouterr().err
        assert told.startswith(says)
        assert bool(told) == there
