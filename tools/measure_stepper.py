"""The time of an answer of `cgtorch.Stepper`, for the skills of a run in the run's own world.

    python tools/measure_stepper.py [RUN] [--skills S2,S3] [--count 300]

It prints the mean, the 99th percentile and the most of all answers in milliseconds of the CPU,
which other work on the machine does not change.
"""

import gc
import time
from pathlib import Path

import click
import torch

from cgtorch import Request, Stepper, open_run
from cgtorch.ground.environment import Environment, Lanes, start_lanes


@click.command()
@click.argument("folder", default="runs/reference", type=click.Path(path_type=Path))
@click.option("--skills", default="S2,S3", show_default=True)
@click.option("--count", default=300, show_default=True, help="Fresh scenarios.")
def command(folder: Path, skills: str, count: int) -> None:
    """The time of an answer of a stepper."""
    torch.set_num_threads(1)
    run = open_run(str(folder))
    scenarios = run.domain.draw("perimeter", count, torch.Generator().manual_seed(11_000_001))
    world = run.domain.world(scenarios)
    for name in skills.split(","):
        stepper = Stepper(run.skills[name])
        took = sorted(t for i in range(count) for t in times(stepper, world, i))
        mean, high, most = (
            1000 * x for x in (sum(took) / len(took), took[-len(took) // 100], took[-1])
        )
        print(f"{name}: {len(took)} answers, mean {mean:.3f}, 99 % {high:.3f}, most {most:.3f} ms")


def times(stepper: Stepper, world: Environment, scenario: int) -> list[float]:
    """The seconds of the CPU for all answers on a scenario."""
    lanes, done, took = start_lanes(world, torch.tensor([scenario]), 0, 0), True, list[float]()
    gc.collect()
    while True:
        percept, begin = lanes.percept[0].tolist(), time.thread_time()
        request = stepper.act(percept, done)
        took.append(time.thread_time() - begin)
        if request.ended:
            return took
        lanes, done = carried_out(request, lanes, world)


def carried_out(request: Request, lanes: Lanes, world: Environment) -> tuple[Lanes, bool]:
    """The lane after a request, and whether that was done."""
    if request.kind == "control":
        lanes, moved = world.step(lanes, torch.tensor([request.control]))
        return lanes, bool(moved)
    if request.kind == "test":
        lanes, chance = world.success(lanes)
        return lanes, bool(chance > 0.5)
    return world.observe(lanes), True


if __name__ == "__main__":
    command()
