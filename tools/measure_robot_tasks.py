"""Train on robot benchmarks, and try the skills by the official protocol.

    python tools/measure_robot_tasks.py FOLDER metaworld:CW10 metaworld:push-v3 [--seeds 0:3]

A skill of Meta-World meets fifty goals per task of the benchmark's own MT1, which training never
draws. Each low-level step is `env.step`, no state is set, and success counts at any step. A skill
of Fetch meets 100 fresh starts in the environment that `gymnasium.make` makes, and success counts
at the last step. FOLDER keeps every run and, beside it, a JSON file with the results; what is there
is not made again. The table is FOLDER/table.md. It tells the forward transfer of a set whose tasks
FOLDER holds one by one, too, with the same seed.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, TypeAlias

import click
import numpy as np
import torch
from options.seeds import seeds_option
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.ground.files import read_json, write_bytes, write_json
from cgtorch.manipulation.domain import Fetch, Manipulation
from cgtorch.manipulation.fetch import FetchSimulator
from cgtorch.manipulation.metaworld import MetaWorldSimulator
from cgtorch.manipulation.simulator import SOLVED, STEPS, Floats, Simulator
from cgtorch.manipulation.world import ArmWorld, Simulators, Starts
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.log import read_log
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.simulation import rollout

GOALS, MT1_SEED = 50, 12345
PUBLISHED = 1_000_000
"""Low-level steps that published learners get for each task of Continual World."""
ONE_BY_ONE = Lock()
"""Goals are drawn by numpy's global generator, which threads share."""
FETCH_STARTS, FETCH_SEED = 100, 50_000_000

Play: TypeAlias = Callable[[ArmWorld], Tensor]
"""Maps a world with one start to the last state (S,) of its episode."""


class Played:
    """States that are never set: an episode goes on from where it is, or begins again."""

    size = 1

    def __init__(self, reset: Any) -> None:
        """Episodes that `reset` begins with a number."""
        self._reset, self._now = reset, 0

    def start(self, number: int) -> tuple[Floats, Any]:
        """Begin an episode."""
        observation = self._reset(number)
        self._now += 1
        return self.read(), observation

    def read(self) -> Floats:
        """The number of this state."""
        return np.array([float(self._now)])

    def write(self, state: Floats, number: int) -> None:
        """Nothing but a check that the episode goes on from here."""
        if state[0] != self._now:
            raise ValueError("an episode went on from another state than the present one")
        self._now += 1


class OfficialMetaWorld(MetaWorldSimulator):
    """The fifty goals of MT1, in an environment of the benchmark, step by step."""

    def __init__(self, task: str, horizon: int) -> None:
        """The environment and the goals of a task."""
        import metaworld

        Simulator.__init__(self, horizon)
        with ONE_BY_ONE:
            benchmark = metaworld.MT1(task, seed=MT1_SEED)
        self.environment = benchmark.train_classes[task]()
        self._goals = benchmark.train_tasks
        self._hand = self.environment.model.body("hand").id
        self.states: Any = Played(self._goal)

    def _goal(self, number: int) -> Floats:
        e = self.environment
        e.set_task(self._goals[number])
        observation: Floats = e.reset()[0]
        return observation

    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool]:
        """See `Simulator.move`."""
        observation, reward, _, _, info = self.environment.step(action)
        return observation, float(reward) / 10, bool(info["success"])


class OfficialFetch(FetchSimulator):
    """Fresh starts in the environment that Gymnasium makes, step by step."""

    def __init__(self, task: str, horizon: int) -> None:
        """The environment of a task."""
        super().__init__(task, horizon)
        import gymnasium

        self._whole = gymnasium.make(task)
        self.environment = self._whole.unwrapped
        self.states: Any = Played(lambda number: self._whole.reset(seed=FETCH_SEED + number)[0])

    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool]:
        """See `Simulator.move`: `is_success` of the environment is what counts."""
        u = np.array([*action[:3], -action[3]], dtype=np.float32)
        observation, *_, info = self._whole.step(u)
        return observation, 0.0, bool(info["is_success"])


@dataclass(frozen=True)
class Official:
    """The successes of a skill in `tried` episodes, and their mean low-level steps."""

    succeeded: int
    tried: int
    steps: float


def official(skill: Skill, domain: Manipulation, task: str, count: int) -> Official:
    """The result of a skill on `count` official starts of a task."""
    return official_of(player_of(skill), domain, task, count)


def player_of(skill: Skill) -> Play:
    """What plays a skill."""

    def play(world: ArmWorld) -> Tensor:
        limit = skill.max_transitions
        return rollout(skill.graph, skill.actions, world, max_transitions=limit).state[0, 0]

    return play


def official_of(play: Play, domain: Manipulation, task: str, count: int) -> Official:
    """The result of whatever plays on `count` official starts of a task."""
    make = OfficialFetch if isinstance(domain, Fetch) else OfficialMetaWorld
    number, solved, steps = domain.tasks.index(task), 0, 0.0
    simulators = Simulators(
        lambda name: make(name, domain.settings.horizon), [task] * len(domain.tasks)
    )
    for start in range(count):
        starts = Starts(torch.tensor([number]), torch.tensor([start]))
        size = simulators[number].size
        state = play(ArmWorld(starts, simulators, domain.arm, size, domain.num_ids))
        solved += bool(state[SOLVED] > 0)
        steps += float(state[STEPS])
    return Official(solved, count, steps / count)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("domains", nargs=-1, required=True)
@seeds_option("0:1")
@click.option("--jobs", default=2, show_default=True, help="Runs side by side.")
@click.option("--count", default=0, help="Official starts per task.  [50; 100 for Fetch]")
@click.option("--options", default="", help="Further options of every run, in one string.")
def command(
    folder: Path, domains: Sequence[str], seeds: range, jobs: int, count: int, options: str
) -> None:
    """Train on robot benchmarks, and try the skills by the official protocol."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(domain, seed) for seed in seeds for domain in domains]
    with ThreadPoolExecutor(jobs) as pool:
        for result in pool.map(lambda job: measured(folder, *job, count, options.split()), todo):
            click.echo(line(result))
    text = table([read_json(path) for path in sorted(folder.glob("*.json"))])
    write_bytes(folder / "table.md", text.encode())
    click.echo(text)


def measured(
    folder: Path, domain: str, seed: int, count: int, options: Sequence[str]
) -> dict[str, Any]:
    """Train one seed, if that is still to be done, and try its last skill."""
    name = f"{domain.replace(':', '-')}-{seed}"
    path, run_folder = folder / f"{name}.json", folder / name
    if path.is_file():
        known: dict[str, Any] = read_json(path)
        return known
    program = [str(Path(sys.executable).parent / "cgtorch-train"), "--domain", domain, *options]
    began = time.perf_counter()
    done = subprocess.run(
        [*program, "--seed", str(seed), "--run-dir", run_folder, "--quiet"], check=False
    )
    seconds = time.perf_counter() - began
    result = {"domain": domain, "seed": seed, "seconds": round(seconds, 1), "rc": done.returncode}
    result |= tried(run_folder, count)
    write_json(path, result)
    return result


def tried(folder: Path, count: int) -> dict[str, Any]:
    """What the last skill of a run does by the official protocol, and what the run has asked."""
    run = read_run(folder)
    domain = run.domain
    if not isinstance(domain, Manipulation):
        raise click.ClickException(f"{folder} is no run of a robot benchmark")
    few = count or (FETCH_STARTS if isinstance(domain, Fetch) else GOALS)
    if run.stages:
        skill = last_skill(folder)[1]
        found = {task: official(skill, domain, task, few) for task in domain.tasks}
    else:  # nothing was learned
        found = dict.fromkeys(domain.tasks, Official(0, few, 0.0))
    return {
        "official": {task: [f.succeeded, f.tried, round(f.steps, 1)] for task, f in found.items()},
        "steps": {
            stage: [sum(each[name] for each in asked.values()) for name in ("steps", "simulated")]
            for stage, asked in asked_by_stage(run).items()
        },
        "generations": {row["stage"]: row["generations"] for row in run.results},
        "w": [[row["w_size"], row["w_lost"]] for row in run.results],
    }  # fmt: skip


def asked_by_stage(run: StoredRun) -> dict[str, dict[str, dict[str, int]]]:
    """Low-level steps of each stage by phase, those of failed tries included."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    for row in read_log(run.folder):
        if row["event"] == "asked":
            phases = found.setdefault(row["stage"], {})
            sums = phases.setdefault(row["phase"], {"steps": 0, "simulated": 0})
            for name in sums:
                sums[name] += row[name]
    return found


def line(result: dict[str, Any]) -> str:
    """One run in a line."""
    rates = [f"{task} {good}/{tries}" for task, (good, tries, _) in result["official"].items()]
    requested, simulated = (sum(n[i] for n in result["steps"].values()) for i in (0, 1))
    return (
        f"{result['domain']} seed {result['seed']}: {', '.join(rates)}; {requested} steps "
        f"requested, {simulated} simulated, {result['seconds']:.0f} s"
    )


def table(results: list[dict[str, Any]]) -> str:
    """Markdown: a line for each run."""
    lines = [
        "| domain | seed | official mean | least | requested | simulated | s | forward transfer |",
        "|---|---|---|---|---|---|---|---|",
    ]
    alone = {
        (next(iter(result["official"])), result["seed"]): result
        for result in results
        if len(result["steps"]) == 1
    }
    for result in results:
        transfer = forward_transfer(result, alone)
        rates = [good / tries for good, tries, _ in result["official"].values()]
        requested, simulated = (sum(n[i] for n in result["steps"].values()) for i in (0, 1))
        cells = (
            f"{result['domain']} | {result['seed']} | {sum(rates) / len(rates):.1%} | "
            f"{min(rates):.0%} | {requested:,} | {simulated:,} | {result['seconds']:.0f} | "
            f"{'–' if transfer is None else f'{transfer:.2f}'}"
        )
        lines.append(f"| {cells} |")
    return "\n".join(lines) + "\n"


def forward_transfer(
    result: dict[str, Any], alone: dict[tuple[str, int], dict[str, Any]]
) -> float | None:
    """How much of what tasks cost alone is saved by what was learned before, on average.

    It is the mean over all tasks but the first one of (A - R) / (1 - R), where A is the area under
    the curve of success over `PUBLISHED` requested steps, and R is that of the task alone (Wolczyk
    et al., "Continual World", NeurIPS 2021). A curve is 0 until the training of a task ends, and
    then what the official goals give. None if a task alone is not there, with the same seed.
    """
    found = list[float]()
    for stage, (requested, _) in list(result["steps"].items())[1:]:
        task = stage.partition("-")[2]
        if (single := alone.get((task, result["seed"]))) is None:
            return None
        ((before, _),) = single["steps"].values()
        mine, other = (
            area(each["official"][task], n) for each, n in ((result, requested), (single, before))
        )
        found.append((mine - other) / (1 - other))
    return sum(found) / len(found) if found else None


def area(official: list[float], steps: int) -> float:
    """The area under a curve that is 0 before so many steps, and then the share of goals solved."""
    good, tries, _ = official
    return good / tries * (1 - min(1.0, steps / PUBLISHED))


if __name__ == "__main__":
    command()
