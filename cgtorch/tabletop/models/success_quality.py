"""How good C is on fresh labels, beside how good any classifier of percepts can be.

A look has noise, and the box around a turned table does not show to which side it is turned, so
scenes with and without success give the same percept. As the scenes are our own, those behind a
percept can be sampled, by importance resampling (Rubin 1987).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.domains.reports import Reliability
from cgtorch.domains.success import calibration
from cgtorch.svm.scores import balanced_accuracy
from cgtorch.tabletop.data import Scenes, label
from cgtorch.tabletop.data.poses import in_table, poses_around, poses_at_object
from cgtorch.tabletop.models.table_posterior import placement_density, tables_behind
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.geometry import bounding_box, box_rectangle, rotate
from cgtorch.tabletop.world.percepts import TABLETOP, parts_of

STEP = (0.05, 0.05, 0.15)  # m, m, rad: standard deviations of a small displacement
_SCENES = 8  # behind each percept
_SURE = 0.02  # probability below which, or this close to 1, C is taken to be sure
_YAWS = 1440  # of a table, which looks the same after half a turn
_MORE = 8  # scenes drawn for each that is kept
_SMALLEST_BLUR = 1e-4  # m


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


def fresh_labels(scenes: Scenes, count: int, generator: Generator) -> FreshLabels:
    """Labels of the world that tell how good C is; see `success_quality`."""
    poses = poses_at_object(scenes, count, generator)
    step = torch.randn(count, 3, generator=generator) * torch.tensor(STEP)
    seed = torch.randint(2**31, (count,), generator=generator)
    moved = replace(poses, pose=poses.pose + step, seed=seed)
    around = poses_around(scenes, count, generator)
    # One batch of labels costs far less than three.
    percept, graspable = label(scenes, poses.joined(moved, around))
    crossed = graspable[:count] != graspable[count : 2 * count]
    crossed &= ~in_table(moved, scenes.footprint)
    return FreshLabels(percept, graspable, count + crossed.nonzero()[:, 0])


def success_quality(
    scenes: Scenes,
    classifier: Callable[[Tensor], Tensor],
    labels: FreshLabels,
    generator: Generator,
) -> SuccessQuality:
    """C, from percepts (n, D) to probabilities (n,), on fresh labels; 1500 take about 2 s (PR2)."""
    count = len(labels.graspable) // 3
    with torch.no_grad():
        chance = classifier(labels.percept)
    best = truth = labels.graspable.to(labels.percept)
    # Scenes are only sampled where C is unsure; elsewhere the label is taken to be certain, which
    # can but raise what is called possible.
    unsure = ((chance > _SURE) & (chance < 1 - _SURE)).nonzero()[:, 0]
    if len(unsure):
        found = success_frequency(scenes, labels.percept[unsure], _SCENES, generator)
        best = truth.index_copy(0, unsure, found)
    near, overall = torch.arange(count), torch.arange(2 * count, 3 * count)
    first, second, third = (
        _judged(chance[rows], truth[rows], best[rows]) for rows in (near, overall, labels.beside)
    )
    return SuccessQuality(first, second, third, calibration(chance[near], truth[near])[1])


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


def success_frequency(
    scenes: Scenes, percept: Tensor, samples: int, generator: Generator
) -> Tensor:
    """Share (n,) of `samples` scenes behind each percept (n, D) in which a grasp succeeds.

    The percepts are of free poses and with the world's noise; each scene costs a label.
    """
    behind = scenes_behind(scenes, percept, samples, generator)
    return label(scenes, behind)[1].to(percept).view(len(percept), samples).mean(1)


def scenes_behind(scenes: Scenes, percept: Tensor, samples: int, generator: Generator) -> Scenarios:
    """Scenes (n · samples) drawn from those that percepts (n, D) leave possible, row by row.

    Objects are placed and tables shaped as in the scenes; every free pose is as likely.
    Obstacles, which are reached over, are left out.
    """
    examples = scenes.draw(64, generator)
    world = scenes.world(examples)
    blur = float(world.blur[..., :TABLETOP].std().clamp_min(_SMALLEST_BLUR))
    many = samples * _MORE
    if scenes.paper_table:
        table, placed, weight = _one_table(percept, examples.table[0], blur, many, generator)
    else:
        table, placed, weight = tables_behind(percept, blur, many, generator)
    yaw = table[..., 2]
    at = rotate(placed - table[..., :2], -yaw)  # in the table's frame
    pose = torch.cat([-rotate(table[..., :2], -yaw), -yaw[..., None]], -1)
    seen = parts_of(percept).height + blur * torch.randn(yaw.shape, generator=generator)
    height = seen.clamp(*examples.table[:, 5].aminmax())[..., None]
    shape = torch.cat([torch.zeros_like(pose), table[..., 3:5], height], -1)
    every = Scenarios(
        pose.reshape(-1, 3),
        shape.reshape(-1, 6),
        at.reshape(-1, 2),
        torch.randint(2**31, (yaw.numel(),), generator=generator),
    )
    weight = weight * ~in_table(every, world.footprint).view(yaw.shape) + 1e-9
    kept = torch.multinomial(weight, samples, replacement=True, generator=generator)
    return every[(kept + many * torch.arange(len(percept))[:, None]).flatten()]


def _one_table(
    percept: Tensor, table: Tensor, blur: float, count: int, generator: Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Tables (n, count, 5), objects (n, count, 2) and weights (n, count) given a table (6,)."""
    noise = blur * torch.randn(len(percept), count, 4, generator=generator)
    seen = parts_of(percept[:, None])
    box = box_rectangle(seen.box)
    centre = box[..., :2] + noise[..., :2] / 2**0.5
    placed = seen.object + noise[..., 2:]
    yaw = _likely_yaw(box[:, 0, 3:], table[3:5], blur, count, generator)
    sides = table[3:5].expand(*yaw.shape, 2)
    weight = placement_density(rotate(placed - centre, -yaw), sides)
    return torch.cat([centre, yaw[..., None], sides], -1), placed, weight


def _likely_yaw(
    extents: Tensor, sides: Tensor, blur: float, count: int, generator: Generator
) -> Tensor:
    """Yaws (n, count) of a table with given sides (2,), drawn given box extents (n, 2)."""
    yaw = torch.arange(_YAWS) * (torch.pi / _YAWS)
    zero = torch.zeros_like(yaw)
    table = torch.stack([zero, zero, yaw, zero + sides[0], zero + sides[1]], 1)
    size = box_rectangle(bounding_box(table))[:, 3:]
    # An extent is the difference of two numbers with noise.
    chance = (-torch.cdist(extents, size).square() / (4 * blur**2)).softmax(1)
    return yaw[torch.multinomial(chance, count, replacement=True, generator=generator)]
