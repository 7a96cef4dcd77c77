"""How good C is on fresh labels, beside how good any classifier of percepts can be."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.domains.reports import Reliability
from cgtorch.domains.success import calibration
from cgtorch.svm.scores import balanced_accuracy
from cgtorch.tabletop.data import label
from cgtorch.tabletop.data.poses import (
    PERIMETER,
    Scenes,
    WorldOf,
    in_table,
    poses_around,
    poses_at_object,
)
from cgtorch.tabletop.models.bayes_accuracy import chance_of_success
from cgtorch.tabletop.world import Scenarios, concatenate_scenarios

STEP = (0.05, 0.05, 0.15)  # m, m, rad: standard deviations of a small displacement
_SCENES = 8  # behind each percept
_SURE = 0.02  # probability below which, or this close to 1, C is taken to be sure


@dataclass(frozen=True)
class Accuracy:
    """How often C(p) > 1/2 is right on labels it was not fitted on.

    Attributes:
        rows: Labels.
        positive: Share of them that succeed.
        accuracy: Share that is right.
        possible: About the share that the best classifier of percepts would have right, which
            answers with the label that most of the scenes behind a percept have.
        balanced: Mean over the two labels of the share that is right.
        possible_balanced: The same of the best classifier.
        calibration_error: Expected calibration error of the probabilities.
    """

    rows: int
    positive: float
    accuracy: float
    possible: float
    balanced: float
    possible_balanced: float
    calibration_error: float


@dataclass(frozen=True)
class SuccessQuality:
    """C on three draws of fresh labels; the base never stands in the table.

    Attributes:
        near: The robot within or just out of reach of the object, any side, any heading.
        overall: The robot anywhere around the table, mostly too far away.
        beside: Poses near the object that a small displacement has brought across the boundary
            between success and failure.
        reliability: Mean probability, frequency and rows of each bin that is not empty, of `near`.
    """

    near: Accuracy
    overall: Accuracy
    beside: Accuracy
    reliability: Reliability


@dataclass(frozen=True)
class FreshLabels:
    """What is seen from three draws of `count` poses each, and whether a grasp succeeds there.

    Attributes:
        percept: (3 · count, D) near the object, each of these displaced, and anywhere.
        graspable: (3 · count,) bool.
        beside: (k,) long, the displaced ones that have crossed the boundary.
    """

    percept: Tensor
    graspable: Tensor
    beside: Tensor


def fresh_labels(
    world_of: WorldOf, count: int, generator: Generator, scenes: Scenes = PERIMETER
) -> FreshLabels:
    """Labels of the world that tell how good C is; see `success_quality`."""
    poses = poses_at_object(world_of, count, generator, scenes)
    moved, around = displaced(poses, generator), poses_around(world_of, count, generator, scenes)
    # One batch of labels costs far less than three.
    percept, graspable = label(world_of, concatenate_scenarios([poses, moved, around]))
    crossed = graspable[:count] != graspable[count : 2 * count]
    crossed &= ~in_table(moved, world_of(moved[:0]).footprint)
    return FreshLabels(percept, graspable, count + crossed.nonzero()[:, 0])


def success_quality(
    world_of: WorldOf,
    classifier: Callable[[Tensor], Tensor],
    labels: FreshLabels,
    generator: Generator,
    scenes: Scenes = PERIMETER,
) -> SuccessQuality:
    """C on fresh labels of the world.

    Args:
        world_of: makes the world of given scenarios.
        classifier: percepts (n, D) to probabilities (n,).
        labels: fresh ones; 500 near the object, as many displaced and as many anywhere take about
            2 s to draw and to judge by with the PR2.
        generator: of all random choices.
        scenes: to draw from.
    """
    count = len(labels.graspable) // 3
    with torch.no_grad():
        chance = classifier(labels.percept)
    truth = labels.graspable.to(labels.percept)
    best = _best_chance(world_of, labels.percept, chance, truth, generator, scenes)
    near, overall = torch.arange(count), torch.arange(2 * count, 3 * count)
    first, second, third = (
        _judged(chance[rows], truth[rows], best[rows]) for rows in (near, overall, labels.beside)
    )
    return SuccessQuality(first, second, third, calibration(chance[near], truth[near])[1])


def displaced(scenarios: Scenarios, generator: Generator) -> Scenarios:
    """The same scenes with other noise and the robot displaced a little, by `STEP`."""
    step = torch.randn(len(scenarios), 3, generator=generator) * torch.tensor(STEP)
    seed = torch.randint(2**31, (len(scenarios),), generator=generator)
    return replace(scenarios, pose=scenarios.pose + step, seed=seed)


def _best_chance(
    world_of: WorldOf,
    percept: Tensor,
    chance: Tensor,
    truth: Tensor,
    generator: Generator,
    scenes: Scenes,
) -> Tensor:
    """Chance of success (n,) given all that a percept (n, D) tells.

    Scenes are only sampled where C is unsure; elsewhere the label is taken to be certain, which
    can but raise what is called possible.
    """
    best = truth.clone()
    unsure = ((chance > _SURE) & (chance < 1 - _SURE)).nonzero()[:, 0]
    if len(unsure):
        best[unsure] = chance_of_success(world_of, percept[unsure], _SCENES, generator, scenes)
    return best


def _judged(chance: Tensor, truth: Tensor, best: Tensor) -> Accuracy:
    """C's probabilities (n,) beside the labels (n,) and the best chances (n,)."""
    answer = (best > 0.5).to(best)
    hits, rejects = best * answer, (1 - best) * (1 - answer)
    found = hits.sum() / best.sum().clamp_min(1e-9)
    refused = rejects.sum() / (1 - best).sum().clamp_min(1e-9)
    return Accuracy(
        rows=len(truth),
        positive=float(truth.mean()),
        accuracy=float(((chance > 0.5) == (truth > 0.5)).float().mean()),
        possible=float((hits + rejects).mean()),
        balanced=float(balanced_accuracy(chance - 0.5, truth - 0.5)),
        possible_balanced=float((found + refused) / 2),
        calibration_error=calibration(chance, truth)[0],
    )
