"""The examples are trained, killed, resumed, shared out and shown by the commands alone."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from forked_ranks import on_ranks, train
from made_once import made_once, shared_folder

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from kill_and_resume import results_of  # the tool that compares runs

from cgtorch.commands import export, report
from cgtorch.ground.environment import start_lanes
from examples.cart import Cart
from examples.mountain_car import HELD, SOLVED, MountainCar, Starts

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
SMALL = [
    *("--population", "60", "--practice", "20", "--transitions", "300"),
    *("--checkpoint-seconds", "0.05", "--quiet"),
]
CAR = "examples.mountain_car:MountainCar"
EXAMPLES = {
    "examples.cart:Cart": ["--target", "0.9", "--rounds", "2", "--generations", "12"],
    CAR: ["--stage", "S0", "--seed", "0"],
}


def process(words: list[str]) -> subprocess.Popen[str]:
    """A command of the library in the checkout's folder."""
    return subprocess.Popen(
        [str(BIN / words[0]), *words[1:]], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def ended(*words: str) -> str:
    """What a command printed, once it has ended well."""
    out, err = (running := process([*words])).communicate(timeout=300)
    assert running.returncode == 0, err
    return out


@pytest.fixture(
    scope="module",
    params=["examples.cart:Cart", pytest.param(CAR, marks=pytest.mark.hostile)],
)
def trained(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """An example's domain and a run about it."""
    domain = request.param
    about = ["--domain", domain, *EXAMPLES[domain], *SMALL]

    def make(run: Path) -> None:
        ended("cgtorch-train", *about, "--run-dir", str(run))

    return domain, made_once(shared_folder(tmp_path_factory) / domain.partition(":")[0], make)


def test_it_is_small_and_stands_alone() -> None:
    sizes = {"cart": 60, "mountain_car": 100}
    for name, most in sizes.items():
        text = (ROOT / "examples" / f"{name}.py").read_text()
        assert text.count("\n") <= most
        assert "cgtorch.tabletop" not in text


def test_it_solves_its_task(trained: tuple[str, Path]) -> None:
    domain, run = trained
    about = ["--domain", domain, "--count", "100", "--seed", "5", "--json"]
    result = json.loads(ended("cgtorch-evaluate", str(run), *about))
    assert result["tried"] == 100
    assert result["rate"] == result["succeeded"] / 100 > 0.5


CART = pytest.mark.parametrize("trained", ["examples.cart:Cart"], indirect=True)


@CART
@pytest.mark.hostile
def test_it_is_the_same_after_a_kill(trained: tuple[str, Path], tmp_path: Path) -> None:
    """Killed in the middle of its first stage, and gone on with by `--resume` alone."""
    domain, wanted = trained
    run = tmp_path / "run"
    about = ["--domain", domain, *EXAMPLES[domain], *SMALL]
    running = process(["cgtorch-train", *about, "--run-dir", str(run)])
    patience = time.monotonic() + 120
    while not list(run.glob("journal/*/*")) and running.poll() is None:
        assert time.monotonic() < patience
        time.sleep(0.02)
    running.send_signal(signal.SIGKILL)
    running.communicate()
    ended("cgtorch-train", "--resume", str(run), "--domain", domain)
    assert results_of(run) == results_of(wanted)


@CART
def test_three_ranks_make_the_same_bits(trained: tuple[str, Path], tmp_path: Path) -> None:
    domain, wanted = trained
    about = ["--domain", domain, *EXAMPLES[domain], *SMALL]
    on_ranks(3, train, [*about, "--run-dir", str(tmp_path / "run")], output=tmp_path / "printed")
    assert results_of(tmp_path / "run") == results_of(wanted)


def test_it_is_reported_and_exported(
    trained: tuple[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, as each new one would load torch once more."""
    domain, run = trained
    monkeypatch.chdir(ROOT)
    page = tmp_path / "page.html"
    words = [str(run), "--domain", domain]
    told = CliRunner().invoke(report.command, [*words, "--output", str(page)])
    assert told.exit_code == 0, told.output
    assert domain in page.read_text()
    for form, ending in {"json": "json", "state-machine": "py", "graphml": "graphml"}.items():
        output = tmp_path / f"skill.{ending}"
        told = CliRunner().invoke(
            export.command, [*words, "--format", form, "--output", str(output)]
        )
        assert told.exit_code == 0, told.output
        assert output.stat().st_size > 100
    assert list(run.glob("events.out.*"))


def test_a_run_is_not_trusted_by_its_file(trained: tuple[str, Path]) -> None:
    _, run = trained
    running = process(["cgtorch-evaluate", str(run)])
    _, err = running.communicate(timeout=120)
    assert running.returncode == 2
    assert "if you trust it, give it as domain (--domain" in err
    assert err.count("\n") == 1


def test_the_valley_is_gymnasiums() -> None:
    """Positions, velocities and points of pushes, step by step as Gymnasium plays them."""
    gymnasium = pytest.importorskip("gymnasium")
    plain = gymnasium.make("MountainCarContinuous-v0")
    observation, _ = plain.reset(seed=3)
    domain: Any = MountainCar()
    world = domain.world(Starts(torch.tensor([float(observation[0])])))
    lanes = start_lanes(world, torch.tensor([0]), 1, 0)
    points, over, pushes = 0.0, False, 0
    while not over and pushes < 40:
        force = 1.0 if observation[1] >= 0 else -1.0
        for _ in range(HELD):
            if over:
                break
            observation, reward, over, _, _ = plain.step(np.array([force], dtype=np.float32))
            points += float(reward)
        lanes, done = world.step(lanes, torch.tensor([[force]]))
        pushes += 1
        assert bool(done.all())
        assert lanes.state[0, :2].tolist() == pytest.approx(observation.tolist(), abs=1e-5)
    assert over
    assert 100 - float(lanes.state[0, 3]) == pytest.approx(points, abs=1e-4)
    assert bool(world.succeeded(lanes.state)[0]) == (points >= SOLVED)


def test_the_cart_feels_the_wind() -> None:
    carts = Cart().draw("any", 3, torch.Generator().manual_seed(0))
    world = Cart().world(carts)
    lanes = start_lanes(world, torch.arange(3), 1, 0)
    after, _ = world.step(lanes, torch.zeros(3, 1))
    assert torch.allclose(after.percept[:, 0], carts.place + carts.wind)
