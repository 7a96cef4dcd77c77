"""From where an object could be grasped, whatever a skill does."""

import math
from dataclasses import replace

import torch
from reaching import reachable
from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.tabletop.stands import FARTHEST, FIRST, NEAREST, graspable_from_somewhere, places
from cgtorch.tabletop.world import random_scenarios


def test_places_are_all_around_and_look_to_the_object() -> None:
    found = places()
    away = found[:, :2].norm(dim=1)
    assert len(found) > 10 * FIRST
    assert float(away.min()) > NEAREST - 1e-5
    assert float(away.max()) < FARTHEST + 1e-5
    seen = torch.atan2(-found[:, 1], -found[:, 0]) - found[:, 2]
    assert (torch.cos(seen) > math.cos(math.pi / 3) - 1e-5).all()
    quadrants = torch.unique(torch.sign(found[:FIRST, :2]), dim=0)
    assert len(quadrants) >= 4, "also among the first"


def test_one_place_is_enough_and_it_is_asked_of_clear_ones_only() -> None:
    scenes = random_scenarios("perimeter", 3, seeded(0))
    asked = []

    def grasps(at: Tensor, table: Tensor) -> Tensor:
        asked.append(at)
        return reachable(at, table)

    assert graspable_from_somewhere(scenes, FOOTPRINT, grasps).all()
    assert len(asked) == 3, "the first places will do"
    assert all(len(at) < FIRST for at in asked), "as the base cannot stand in the table"
    assert all((at[:, 2] == scenes.table[0, 5]).all() for at in asked)
    near = [at[:, :2].norm(dim=1) for at in asked]
    assert all(((d > NEAREST - 1e-5) & (d < FARTHEST + 1e-5)).all() for d in near)
    rare = graspable_from_somewhere(scenes, FOOTPRINT, lambda at, table: at[:, 0] > FARTHEST - 1e-4)
    assert rare.any(), "the others are tried as well"


def test_boxes_that_fill_the_floor_leave_no_place() -> None:
    scenes = random_scenarios("perimeter", 2, seeded(0))
    fence = torch.tensor([[[0.0, 0, 0, 9, 9], [0, 0, 0, 0, 0]]])
    absent = torch.zeros(1, 2, 5)
    fenced = replace(scenes, obstacles=torch.cat([fence, absent]))
    assert graspable_from_somewhere(fenced, FOOTPRINT, reachable).tolist() == [False, True]
