import math

import pytest
import torch
from reaching import world_of
from support import seeded

from cgtorch.ground.errors import SettingsError
from cgtorch.improvement.trial import first_percepts
from cgtorch.tabletop.world import (
    EDGES,
    PLACEMENTS,
    cluttered_scenarios,
    random_scenarios,
    stage_scenarios,
)
from cgtorch.tabletop.world.scenarios import CORNER, _along_an_edge

COUNT = 4000


def edge_of(x: float, y: float, nearest: str) -> float:
    """Distance (m) of an object to an edge of the 0.8 m × 1.2 m table, seen from its centre."""
    return {"near": 0.4 + x, "far": 0.4 - x, "left": 0.6 - y, "right": 0.6 + y}[nearest]


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_tables_and_starts_are_as_the_experiments_have_them(placement: str) -> None:
    s = random_scenarios(placement, COUNT, seeded(0))
    assert len(s) == COUNT
    wanted = torch.tensor([0.0, 0.0, 0.0, 0.8, 1.2, 0.74])
    torch.testing.assert_close(s.table, wanted.expand(COUNT, 6))
    ranges = [(-0.4 - 1.2, -0.4 - 0.8), (-0.2, 0.2), (-math.radians(5), math.radians(5))]
    for values, (low, high) in zip(s.pose.T, ranges, strict=True):
        assert values.min() >= low - 1e-6
        assert values.max() <= high + 1e-6
        uniform = (values - low) / (high - low)  # of mean 1/2 and variance 1/12
        assert uniform.mean().item() == pytest.approx(0.5, abs=0.02)
        assert uniform.var().item() == pytest.approx(1 / 12, rel=0.05)
    assert len(s.seed.unique()) == COUNT


@pytest.mark.parametrize("edge", EDGES)
def test_objects_stand_along_their_edge(edge: str) -> None:
    s = random_scenarios(edge, COUNT, seeded(0))
    inset = torch.tensor([edge_of(x, y, edge) for x, y in s.object.tolist()])
    assert inset.min() >= 0.05 - 1e-6
    assert inset.max() <= 0.15 + 1e-6
    assert inset.mean().item() == pytest.approx(0.1, abs=0.002)
    along = s.object[:, 1] / 0.55 if edge in ("near", "far") else s.object[:, 0] / 0.35
    assert along.abs().max() <= 1 + 1e-6
    assert along.mean().item() == pytest.approx(0, abs=0.04)
    assert along.var().item() == pytest.approx(1 / 3, rel=0.05)


def test_the_perimeter_is_all_four_edges_by_their_length() -> None:
    s = random_scenarios("perimeter", COUNT, seeded(0))
    x, y = s.object.T
    inset = torch.stack([0.4 + x, 0.4 - x, 0.6 - y, 0.6 + y]).amin(0)
    assert inset.min() >= 0.05 - 1e-6
    assert inset.max() <= 0.15 + 1e-6
    # Away from the corners there is no doubt which edge an object was put on.
    sides = (x.abs() < 0.25) & (y.abs() >= 0.45)
    ends = (y.abs() < 0.45) & (x.abs() >= 0.25)
    wanted = (0.8 / 4.0 * 2) * (0.25 / 0.35) / ((1.2 / 4.0 * 2) * (0.45 / 0.55))
    assert sides.sum() / ends.sum() == pytest.approx(wanted, rel=0.1)
    assert (y[sides] > 0).float().mean().item() == pytest.approx(0.5, abs=0.05)
    assert (x[ends] > 0).float().mean().item() == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("count", [2, 5, 9])
def test_stage_objects_are_evenly_spaced_from_corner_to_corner(edge: str, count: int) -> None:
    s = stage_scenarios(edge, count)
    assert len(s) == count
    torch.testing.assert_close(s.pose, torch.tensor([-1.4, 0.0, 0.0]).expand(count, 3))
    for x, y in s.object.tolist():
        assert edge_of(x, y, edge) == pytest.approx(0.1)
    axis, half = (1, 0.6) if edge in ("near", "far") else (0, 0.4)
    along = s.object[:, axis]
    assert along.sort().values.tolist() == pytest.approx(
        [-half + 0.05 + i * (2 * half - 0.1) / (count - 1) for i in range(count)], abs=1e-6
    )
    assert len(s.seed.unique()) == count


def test_the_right_edge_includes_its_far_corner() -> None:
    """The top-right corner, where the paper's skill failed."""
    s = stage_scenarios("right")
    assert s.object[-1].tolist() == pytest.approx([0.35, -0.5])


def test_scenarios_depend_on_the_generator_alone() -> None:
    one, again, other = (random_scenarios("perimeter", 10, seeded(s)) for s in (0, 0, 1))
    for name, value in vars(one).items():
        assert torch.equal(value, getattr(again, name))
    assert not torch.equal(one.object, other.object)


def test_batches_can_be_joined_and_taken_apart() -> None:
    parts = [stage_scenarios(edge) for edge in EDGES]
    whole = parts[0].joined(*parts[1:])
    assert len(whole) == 20
    for name, value in vars(whole[5:10]).items():
        assert torch.equal(value, getattr(parts[1], name))


def test_those_without_obstacles_get_some_of_size_zero_beside_others() -> None:
    with_some = cluttered_scenarios(4, seeded(0))
    whole = stage_scenarios("near", 2).joined(with_some, with_some[:0])
    assert whole.obstacles.shape == (6, 1, 5)
    assert not whole.obstacles[:2].any()
    assert torch.equal(whole.obstacles[2:], with_some.obstacles)
    assert with_some[:0].joined(stage_scenarios("near", 0)).obstacles.shape[1] == 1
    assert stage_scenarios("near", 2).obstacles.shape == (2, 0, 5)


@pytest.mark.parametrize("placement", ["top", "", "Near", "near "])
def test_unknown_placements_are_refused(placement: str) -> None:
    with pytest.raises(SettingsError, match=f"unknown .*{placement!r}; use one of near, left"):
        random_scenarios(placement, 3, seeded(0))
    with pytest.raises(SettingsError, match=f"unknown .*{placement!r}; use one of near, left"):
        stage_scenarios(placement)


def test_the_perimeter_is_a_placement_but_no_edge() -> None:
    with pytest.raises(SettingsError, match="left, right, far, perimeter"):
        random_scenarios("top", 3, seeded(0))
    with pytest.raises(SettingsError, match="unknown table edge 'perimeter'"):
        stage_scenarios("perimeter")


def test_counts_that_cannot_be() -> None:
    assert len(random_scenarios("near", 0, seeded(0))) == 0
    with pytest.raises(SettingsError, match="count is -1; give"):
        random_scenarios("near", -1, seeded(0))
    with pytest.raises(SettingsError, match="count is -1; give"):
        stage_scenarios("near", -1)


def test_trials_meet_other_noise() -> None:
    scenarios = random_scenarios("near", 40, seeded(3))
    seeds = torch.cat([scenarios.with_noise(i).seed for i in range(3)])
    assert torch.equal(scenarios.with_noise(0).seed, scenarios.seed)
    assert len(set(seeds.tolist())) == 120
    first = [first_percepts(world_of(scenarios.with_noise(i))) for i in range(2)]
    assert 0 < float((first[0] - first[1]).abs().max()) < 0.06


def test_a_longer_edge_has_more_of_the_objects() -> None:
    """Of a table of 0.6 m by 1.4 m, seven of ten are along the longer edges."""
    pick = torch.tensor([0.1, 0.65, 0.75, 0.95])
    along, inset = torch.tensor([1.0, -0.5, 1.0, -0.5]), torch.full((4,), 0.1)
    found = _along_an_edge(torch.tensor([0.6, 1.4]).expand(4, 2), pick, along, inset)
    long, short = 0.7 - CORNER, 0.3 - CORNER
    wanted = [[-0.2, long], [0.2, -long / 2], [short, -0.6], [-short / 2, 0.6]]
    torch.testing.assert_close(found, torch.tensor(wanted))
