"""Which names are those of devices; tests of commands choose the fastest on a GPU."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from support import create_run, recurrent_actions

from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import SettingsError
from cgtorch.report import ProgressDisplay
from cgtorch.runs.settings import RunSettings
from cgtorch.training import device as module
from cgtorch.training.device import WORTH_A_GPU, device_for, device_named


@pytest.mark.parametrize("name", ["abacus", "meta", "cuda:99"])
def test_what_cannot_calculate_is_no_device(name: str) -> None:
    with pytest.raises(SettingsError, match=f"device '{name}' cannot be used; give auto, cpu"):
        device_named(name)


def test_each_rank_of_a_machine_has_its_own_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCAL_RANK", "99")
    assert device_named("cpu") == torch.device("cpu")
    with pytest.raises(SettingsError, match="device 'cuda' cannot be used"):
        device_named("cuda")


def test_the_one_that_is_asked_for_is_used(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = create_run(tmp_path / "run", RunSettings())
    with ProgressDisplay(quiet=False) as display:
        assert device_for(run, "cpu", display) == torch.device("cpu")
        with pytest.raises(SettingsError, match="abacus"):
            device_for(run, "abacus", display)
        if not torch.cuda.is_available():
            assert device_for(run, "auto", display) == torch.device("cpu")
            assert "device: " not in "".join(capfd.readouterr())  # there is no choice to tell


FEW, MANY = WORTH_A_GPU - 1, WORTH_A_GPU


@pytest.mark.parametrize(
    ("population", "about", "says"),
    [
        (MANY, {}, f"cuda, which is faster for a population of {MANY}; --device cpu selects"),
        (FEW, {}, f"cpu, which is as fast as a GPU for a population of {FEW}; --device cuda"),
        (MANY, {"kernels": False}, "cpu, which is faster, as a GPU has no kernels for this run"),
        (MANY, {"memory": True}, "cpu, which is faster, as a GPU has no kernels for this run"),
        (MANY, {"ranks": 2}, "cpu, which is faster, as a GPU has no kernels for this run"),
    ],
)
def test_a_gpu_is_chosen_for_large_populations_that_its_kernels_support(
    population: int,
    about: dict[str, int],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """A machine with a GPU is only said to be there; nothing is calculated on it."""
    run = create_run(tmp_path / "run", RunSettings(population=population))
    if about.get("memory"):
        run = replace(run, actions=recurrent_actions())
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    launcher = object() if about.get("kernels", True) else None
    monkeypatch.setattr(module, "launcher_of", lambda device: launcher)
    monkeypatch.setattr(ranks, "count", lambda: about.get("ranks", 1))
    with ProgressDisplay(quiet=False) as display:
        found = device_for(run, "auto", display)
    text = " ".join("".join(capfd.readouterr()).split())
    assert f"device: {says}" in text
    assert found.type == says.split(",")[0]


@pytest.mark.parametrize(("rank", "asked"), [("3", "cuda:3"), (None, "cuda")])
def test_a_gpu_has_the_number_of_the_rank_if_there_are_ranks(
    rank: str | None, asked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No GPU has to be there."""
    zeros, met = torch.zeros, list[torch.device]()

    def there(count: int, device: torch.device) -> torch.Tensor:
        met.append(device)
        return zeros(count)

    monkeypatch.delenv("LOCAL_RANK", raising=False)
    if rank is not None:
        monkeypatch.setenv("LOCAL_RANK", rank)
    monkeypatch.setattr(torch, "zeros", there)
    assert device_named("cuda") == torch.device(asked)
    assert device_named("cuda:1") == torch.device("cuda:1")
    assert met == [torch.device(asked), torch.device("cuda:1")]
