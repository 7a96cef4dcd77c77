"""`cgtorch-train --device cuda` to its end, where tensors say that they are on a GPU."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from command_line import TRAIN, Shell, edited
from emulated_gpu import EmulatedGpu, OnGpu
from pretended_gpu import pretended_gpu
from rich.console import Console
from safetensors.torch import load_file
from support import custom_actions
from told_by_runs import result_of
from trained import Trained, copied

from cgtorch.graphs import RecurrentNN
from cgtorch.native import gpu as native_gpu
from cgtorch.report import ProgressDisplay
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import planned_run
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.device import fastest_device


def quick(trained: Trained, folder: Path) -> Path:
    """A run that has its first models, and ends its stages soon."""
    edited(
        copied(trained, folder, ()),
        {"practice": 0, "generations": 2, "attempts": 1, "population": 30},
    )
    return folder


@pytest.mark.hostile
def test_a_skill_is_evolved_there(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    run = quick(trained, tmp_path / "run")
    with pretended_gpu() as gpu:
        shell.does(TRAIN, "--resume", run, "--stage", "S0", "--device", "cuda", "--quiet")
    assert gpu.waits["torch_engine.py: _grouped"] > 10  # rollouts were there
    stage = result_of(run, "S0")
    assert stage["generations"] > 0
    assert stage["transitions"] > 0


@pytest.mark.parametrize(
    ("population", "kernels", "actions", "wanted", "says"),
    [
        (4000, True, "", "cuda", "device: cuda, which is faster for a population of 4000"),
        (3999, True, "", "cpu", "device: cpu, which is as fast as a GPU for a population of 3999"),
        (4000, False, "", "cpu", "device: cpu, which is faster, as a GPU has no kernels"),
        (4000, True, "own", "cpu", "device: cpu, which is faster, as a GPU has no kernels"),
        (4000, True, "memory", "cpu", "device: cpu, which is faster, as a GPU has no kernels"),
    ],
)
def test_the_fastest_device_is_taken_and_said_where_there_is_a_gpu(
    population: int,
    kernels: bool,
    actions: str,
    wanted: str,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = planned_run(tmp_path, RunSettings(population=population), TabletopSettings())
    if actions:
        memory = paper_actions().extended(["RecurrentNN"], [RecurrentNN()])
        run = replace(run, actions=custom_actions() if actions == "own" else memory)
    monkeypatch.setattr(native_gpu, "gpu_of", lambda device: EmulatedGpu() if kernels else None)
    display = ProgressDisplay(Console(stderr=True, width=200))
    assert fastest_device(run, display) == torch.device("cpu")
    assert not capsys.readouterr().err
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert fastest_device(run, display) == torch.device(wanted)
    assert capsys.readouterr().err.startswith(says)


@pytest.mark.hostile
def test_a_run_may_go_on_on_another_device(
    shell: Shell, trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One stage on what stands in for a GPU, one on the CPU: as on the CPU alone."""
    wanted, found = (quick(trained, tmp_path / name) for name in ("wanted", "found"))
    shell.does(TRAIN, "--resume", wanted, "--stage", "S1", "--quiet")
    monkeypatch.setattr(native_gpu, "gpu_of", lambda device: OnGpu())
    words = [TRAIN, "--resume", found, "--checkpoint-seconds", 0, "--quiet"]
    with pretended_gpu():
        shell.does(*words, "--stage", "S0", "--device", "cuda")
    shell.does(*words, "--stage", "S1")
    for stage in ("S0", "S1"):
        names = sorted(p.name for p in (wanted / stage).glob("*.safetensors"))
        assert names
        for name in names:
            one, other = (load_file(run / stage / name) for run in (wanted, found))
            assert one.keys() == other.keys()
            assert all(torch.equal(one[key], other[key]) for key in one), name
