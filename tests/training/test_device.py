"""Which names are those of devices; tests of commands choose the fastest on a GPU."""

from pathlib import Path

import pytest
import torch
from support import create_run

from cgtorch.ground.errors import SettingsError
from cgtorch.report import ProgressDisplay
from cgtorch.runs.settings import RunSettings
from cgtorch.training.device import device_for, device_named


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
