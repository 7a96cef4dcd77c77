"""The course of the evolutions: TensorBoard's steps as generations, counted from 1."""

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

from cgtorch.report.page.contents import Contents

GENERATION = "fitness/best"
TESTED = "world/solved_M"
V = TypeVar("V")


@dataclass(frozen=True)
class Course:
    """When things happened in a run.

    Attributes:
        steps: TensorBoard's, of each generation.
        ends: the last generation of each evolution, at a test in the world or a stage's end.
        stages: name, first and last generation of each finished stage that had any; empty where
            the event files do not hold all generations of the run.
    """

    steps: tuple[int, ...]
    ends: tuple[int, ...]
    stages: tuple[tuple[str, int, int], ...]

    def generation(self, step: int) -> int:
        """The number of generations done at a step."""
        return bisect_right(self.steps, step)

    def lines(self, points: Iterable[tuple[int, V]]) -> list[list[tuple[int, V]]]:
        """Points by generation, one line for each evolution, so that none joins two."""
        lines: dict[int, list[tuple[int, V]]] = {}
        for step, value in points:
            number = self.generation(step)
            lines.setdefault(bisect_right(self.ends, number - 1), []).append((number, value))
        return list(lines.values())


def course_of(contents: Contents) -> Course | None:
    """The course of a run, None if its event files hold no generation."""
    steps = tuple(step for step, _ in contents.events.scalars.get(GENERATION, ()))
    if not steps:
        return None
    tested = {bisect_right(steps, step - 1) for step, _ in contents.events.scalars.get(TESTED, ())}
    counts = [stage.result["generations"] for stage in contents.stages]
    stages, first = [], 1
    if sum(counts) <= len(steps):
        for stage, count in zip(contents.stages, counts, strict=True):
            if count:
                stages.append((stage.name, first, first + count - 1))
            first += count
    ends = sorted({*tested, *(last for _, _, last in stages)} - {0})
    return Course(steps, tuple(ends), tuple(stages))
