"""A Gymnasium environment of one's own, from its options to its report."""

import re
import shutil
from pathlib import Path

import pytest
from command_line import EVALUATE, EXPORT, REPORT, TRAIN, Shell, about, in_a_shell, listing

import cgtorch
from cgtorch.ground.errors import DomainError

pytest.importorskip("gymnasium")

PUSH = '''
from pathlib import Path

import gymnasium
import numpy as np

Path(__file__).with_name("imported").write_text("yes")


class Push(gymnasium.Env):
    """A cart that is to be pushed over a line."""

    def __init__(self, line=0.5):
        box = gymnasium.spaces.Box(-9, 9, (1,))
        self.observation_space = gymnasium.spaces.Dict(
            place=box, goal=box, say=gymnasium.spaces.Text(3)
        )
        self.action_space = gymnasium.spaces.Box(-1, 1, (1,))
        self.line = line

    def _seen(self):
        return {"place": self.place, "goal": np.full(1, self.line), "say": "go"}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1, 0, 1)
        return self._seen(), {}

    def step(self, action):
        self.place = self.place + action
        gap = float(self.line - self.place[0])
        return self._seen(), -abs(gap), False, False, {"success": gap < 0}


def wrapped(environment):
    return environment


gymnasium.register("Push-v0", Push, max_episode_steps=8)
'''
NAME = "gymnasium:push:Push-v0+push:wrapped"
GIVEN = ["--domain", "gymnasium:push:Push-v0", "--wrappers", "push:wrapped"]
OWN = ["--env", "line=0.4", "--percepts", "place", "--success", "success", "--target", "0.9"]
SMALL = ["--population=20", "--generations=20", "--practice=3", "--rounds=1", "--hidden=12"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the module of an environment, and a run about it."""
    folder = tmp_path_factory.mktemp("pushes")
    (folder / "push.py").write_text(PUSH)
    ended = in_a_shell(TRAIN, *GIVEN, *OWN, *SMALL, "--run-dir", "run", folder=folder)
    assert ended.code == 0, ended.err
    assert "Percepts lack say" not in ended.err  # as they were chosen
    assert "evolve skills until the target of 0.9 is met" in ended.said
    assert f"cgtorch-evaluate run --domain {NAME}" in ended.err
    (folder / "imported").unlink()
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    return folder


@pytest.fixture
def pushes(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that, to be changed."""
    copy = Path(shutil.copytree(made, tmp_path / "copy"))
    monkeypatch.chdir(copy)
    return copy


def test_the_options_are_kept(made: Path) -> None:
    found = about(made / "run")
    assert found["settings"]["domain"] == NAME
    assert found["domain_settings"] == {
        "environment": "push:Push-v0",
        "target_return": "inf",
        "env": ["line=0.4"],
        "percepts": ["place"],
        "success": "success",
        "success_at": "any",
        "wrappers": ["push:wrapped"],
        "reward": "",
        "hidden": 12,
    }


def test_every_command_takes_the_name(shell: Shell, pushes: Path) -> None:
    found = shell.told(EVALUATE, "run", "--domain", NAME, "--count", "20")
    assert found["succeeded"] > 10
    assert found["mean_return"] is None
    assert shell.does(REPORT, "run", "--domain", NAME, "--output", "page.html").err == ""
    page = (pushes / "page.html").read_text()
    assert "success in the info, at any step" in page
    assert page.count("--percepts place") == 1
    assert "--wrappers" not in page  # which the name says
    shell.does(EXPORT, "run", "--domain", NAME, "--format", "state-machine", "--output", "x.py")
    ended = shell.does(TRAIN, "--resume", "run", *GIVEN, "--target", "0.5")
    assert "its goal of 0.5" in ended.said


@pytest.mark.parametrize(
    "words",
    [
        (TRAIN, "--resume", "run"),
        (EVALUATE, "run"),
        (EXPORT, "run", "--format", "json", "--output", "x"),
        (REPORT, "run", "--output", "x"),
    ],
)
def test_nothing_is_imported_because_a_run_names_it(
    shell: Shell, pushes: Path, words: tuple[str, ...]
) -> None:
    before = listing(pushes)
    message = shell.refuses(*words)
    assert f"is code of its own; if you trust it, give it as domain (--domain {NAME})" in message
    message = shell.refuses(*words, "--domain", "gymnasium:Push-v0")
    assert "not 'gymnasium:Push-v0'; give that" in message
    assert listing(pushes) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--env", "line"], "env is 'line'; give NAME=VALUE"),
        (["--env", "size=3"], "unexpected keyword argument 'size'"),
        (["--percepts", "speed"], "percepts 'speed' matches nothing"),
        (["--percepts", "say"], "say of environment 'push:Push-v0' is Text"),
        (["--wrappers", "push:lost"], "cannot import wrapper 'push:lost'"),
        (["--success-at", "first"], "success_at is 'first'; use one of any, last"),
    ],
)
def test_options_that_cannot_work(
    shell: Shell, pushes: Path, words: list[str], message: str
) -> None:
    (pushes / "imported").touch()
    assert message in shell.refuses(TRAIN, *GIVEN[:2], *words, "--run-dir", "new")
    assert not (pushes / "new").exists()


SLOW = """
import time
import gymnasium


class Slow(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, (1,))
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        time.sleep(0.02)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, True, False, {}


gymnasium.register("Slow-v0", Slow)
"""


@pytest.mark.parametrize("door", ["command", "Python"])
def test_a_long_look_at_an_environment_is_told_of(
    shell: Shell,
    tmp_path: Path,
    door: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("cgtorch.report.progress.OFTEN", 0.05)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "slow.py").write_text(SLOW)
    name, lacking = "gymnasium:slow:Slow-v0", "names no return from which it counts as solved"
    if door == "command":
        lines = shell(TRAIN, "--domain", name, "--run-dir", "run").err.splitlines()
        assert lacking in lines.pop()
    else:
        with pytest.raises(DomainError, match=lacking):
            cgtorch.train(name, "run")
        lines = capsys.readouterr().err.splitlines()
    assert len(lines) > 1
    assert all(re.match(r"random episodes: \d+ of 20, .*/s, left 0:0", line) for line in lines)
