"""Skills of whole trainings, tried in physics on fresh placements."""

import subprocess
import sys
import time
from functools import partial
from pathlib import Path

from cgtorch.commands.common import waiting
from cgtorch.ground.files import read_json, write_json
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.world import EDGES
from cgtorch.training.evaluate import evaluate_skill
from in_physics.tried import Rows, Sizes, Tried

FRESH_SEED = 11_000_001
"""Of the fresh placements; far from the seeds that runs draw theirs with."""


def kinematic(folder: Path, sizes: Sizes) -> Rows:
    """S3 of the PR2 trained in the kinematic world."""
    for seed in sizes.seeds:
        about = f"S3 of seed {seed}, trained in the kinematic world"
        run = trained(folder / f"kinematic-{seed}", "--stage", "S3", "--seed", str(seed))
        yield from everywhere(run, sizes, seed, about, "99 %, 97 %", "99 %")


def physics(folder: Path, sizes: Sizes) -> Rows:
    """S3 of the PR2 trained in physics, and how long that took."""
    for seed in sizes.seeds:
        words = ["--stage", "S3", "--seed", str(seed), "--world", "mujoco"]
        run = trained(folder / f"physics-{seed}", *words)
        about = f"S3 of seed {seed}, trained in physics in {minutes(run)}"
        yield from everywhere(run, sizes, seed, about, "99.5 %, 99 %", "99 %")


def fetch(folder: Path, sizes: Sizes) -> Rows:
    """S3 of the Fetch trained in the kinematic world, on the perimeter."""
    seed = sizes.seeds[0]
    words = ["--stage", "S3", "--seed", str(seed), "--robot", "fetch"]
    run = trained(folder / f"fetch-{seed}", *words)
    about = f"Fetch, S3 of seed {seed}, trained in the kinematic world: perimeter"
    yield about, partial(tried, run, "perimeter", sizes.count, seed, about, "98 %")


def everywhere(run: Path, sizes: Sizes, seed: int, what: str, asked: str, of_edges: str) -> Rows:
    """On the perimeter, and along each edge on fewer."""
    for kind in ("perimeter", *EDGES):
        whole, about = kind == "perimeter", f"{what}: {kind}"
        count = sizes.count if whole else sizes.fewer
        yield about, partial(tried, run, kind, count, seed, about, asked if whole else of_edges)


def tried(run: Path, kind: str, count: int, seed: int, about: str, asked: str) -> Tried:
    """The last skill of a run on fresh placements, as by `cgtorch-evaluate --world mujoco`."""
    opened, skill = last_skill(run)
    strict = opened.domain.in_world("mujoco")
    (allowed,) = strict.other_measures().values()  # which shares what physics has answered
    found = []
    for domain in (strict, allowed):
        with waiting(about, False, count) as done:
            found.append(evaluate_skill(skill, domain, kind, count, FRESH_SEED + seed, done))
    return Tried(about, count, found[1].successes, found[0].successes, asked)


def trained(run: Path, *words: str) -> Path:
    """A run, trained by one command unless it is there already; one that was cut off goes on."""
    if not (run / "seconds.json").is_file():
        began = time.monotonic()
        program = str(Path(sys.executable).with_name("cgtorch-train"))
        subprocess.run([program, *words, "--run-dir", run, "--quiet"], check=True)
        write_json(run / "seconds.json", time.monotonic() - began)
    return run


def minutes(run: Path) -> str:
    """How long a training took, as minutes and seconds."""
    return "{}:{:02}".format(*divmod(round(read_json(run / "seconds.json")), 60))
