"""Several processes of one training: the same results, one voice, and one error."""

import sys
from pathlib import Path

import pytest
from command_line import TRAIN, Ended, Shell, in_a_shell

pytest.importorskip("gymnasium")

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from kill_and_resume import results_of

from cgtorch.commands.training import usual_processes
from cgtorch.ground import distributed as ranks
from cgtorch.runs.stored_run import read_run

SLIDE = '''
import os

import gymnasium
import numpy as np

BEGUN = os.getpid()


class Slide(gymnasium.Env):
    """A thing that is to be held in the middle."""

    observation_space = gymnasium.spaces.Box(-9, 9, (1,))
    action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def __init__(self, once=0):
        self.once = once

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-2, 2, 1)
        return self.place, {}

    def step(self, action):
        if self.once and os.getpid() != BEGUN:
            raise ValueError("there is one licence")
        self.place = np.clip(self.place + action, -9, 9)
        return self.place, -float(abs(self.place[0])), False, False, {}


gymnasium.register("Slide-v0", Slide, max_episode_steps=6)
'''
SMALL = ["--target=-0.5", "--population=12", "--generations=6", "--attempts=1", "--rounds=1"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "slide.py").write_text(SLIDE)
    return tmp_path


def trained(folder: Path, *words: str) -> Ended:
    about = "--domain", "gymnasium:slide:Slide-v0", "--run-dir", "run", *SMALL
    return in_a_shell(TRAIN, *about, *words, folder=folder)


@pytest.mark.hostile
def test_any_number_of_processes_gives_the_same_files_and_says_the_same_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for count in ("1", "3"):
        ended = trained(folder, "--processes", count)
        assert ended.code == 0, ended.err
        found.append((results_of(folder / "run"), ended.out.splitlines()[-1]))
        assert ended.err.count("New run run") == 1
        assert ended.err.count("Next:") == 1
        (folder / "run").rename(folder / f"run-{count}")
    assert found[0] == found[1]
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    run = read_run(folder / "run-3", domain="gymnasium:slide:Slide-v0")
    for cores, processes in ((1, 1), (2, 2), (3, 3), (64, 3)):  # 12 individuals
        monkeypatch.setattr(ranks, "cores", lambda cores=cores: cores)
        assert usual_processes(run) == processes


@pytest.mark.hostile
def test_an_error_in_another_process_is_told_once_and_the_run_goes_on(folder: Path) -> None:
    ended = trained(folder, "--env", "once=1", "--processes", "2", "--quiet")
    assert ended.code == 2
    assert len(ended.err.split("cgtorch-train: ")) == 2
    assert "raised ValueError: there is one licence" in ended.said
    assert "--resume run" in ended.said
    again = in_a_shell(
        TRAIN, "--resume", "run", "--domain", "gymnasium:slide:Slide-v0", "--processes", "1",
        folder=folder,
    )  # fmt: skip
    assert again.code == 0, again.err


def test_a_number_below_one_is_refused(shell: Shell) -> None:
    assert "--processes" in shell.refuses(TRAIN, "--processes", 0)
