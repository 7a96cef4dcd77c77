from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from support import seeded

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.table_picture import SCENES, draw_placements, draw_scenes, draw_table_top
from cgtorch.tabletop.world import (
    Scenarios,
    cluttered_scenarios,
    random_scenarios,
    stage_scenarios,
)
from cgtorch.tabletop.world.geometry import corners


def some() -> tuple[Scenarios, torch.Tensor, torch.Tensor]:
    scenarios = random_scenarios("perimeter", 30, seeded(0)).joined(stage_scenarios("right"))
    succeeded = torch.rand(35, generator=seeded(1)) < 0.7
    return scenarios, succeeded, torch.arange(35) >= 30


def by_gid(figure: Any) -> dict[str, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    return {a.get_gid(): a for a in (*axes.collections, *axes.patches) if a.get_gid()}


def test_every_object_is_where_it_stands() -> None:
    scenarios, succeeded, targets = some()
    parts = by_gid(draw_table_top(scenarios, succeeded, targets))
    for gid, chosen in (("reached", succeeded), ("missed", ~succeeded), ("targets", targets)):
        wanted = scenarios.object[chosen].flip(1).numpy()
        assert np.allclose(parts[gid].get_offsets(), wanted)
    assert len(parts["robots"].get_paths()) == 31  # the five share a start


def test_marks_differ_without_colour() -> None:
    scenarios, succeeded, targets = some()
    parts = by_gid(draw_table_top(scenarios, succeeded, targets))
    shapes = [len(parts[g].get_paths()[0].vertices) for g in ("reached", "missed")]
    assert shapes[0] != shapes[1]
    assert parts["targets"].get_sizes()[0] > 2 * parts["reached"].get_sizes()[0]
    assert len(parts["targets"].get_facecolors()) == 0  # a ring hides no mark


def test_title_and_legend_count() -> None:
    scenarios, succeeded, targets = some()
    figure = draw_table_top(scenarios, succeeded, targets, title="S2")
    axes = figure.axes[0]
    good, both = int(succeeded.sum()), int((succeeded & targets).sum())
    assert axes.get_title() == f"S2: {good} of 35 reached\n{both} of 5 test placements"
    names = [t.get_text() for t in figure.legends[0].get_texts()]
    assert f"reached ({good})" in names
    assert f"missed ({35 - good})" in names
    plain = draw_table_top(scenarios, succeeded)
    assert plain.axes[0].get_title() == f"{good} of 35 reached"


def test_scale_orientation_and_edge_names() -> None:
    scenarios, succeeded, targets = some()
    figure = draw_table_top(scenarios, succeeded, targets)
    corners = by_gid(figure)["table"].get_xy()
    assert np.ptp(corners, 0) == pytest.approx([1.2, 0.8], abs=1e-6)
    axes = figure.axes[0]
    at = axes.transData.transform
    origin, left, away = (np.array(at(p)) for p in ((0, 0), (1, 0), (0, 1)))
    assert left[0] - origin[0] == pytest.approx(-(away[1] - origin[1]), rel=1e-6)
    assert left[0] < origin[0]  # the robot's left is left
    places = {t.get_text(): np.array(t.get_position()) for t in axes.texts}
    assert set(places) == {"near", "left", "right", "far"}
    assert places["near"][1] < -0.4 < 0.4 < places["far"][1]
    assert places["left"][0] > 0.6
    assert places["right"][0] < -0.6
    assert "(m)" in axes.get_xlabel()
    assert "(m)" in axes.get_ylabel()


def test_a_turned_robot_and_a_turned_table() -> None:
    scenarios = stage_scenarios("near", 1)
    quarter = torch.pi / 2
    pose = torch.tensor([[-2.0, 1.0, quarter]])
    table = torch.tensor([[0.5, -0.5, quarter, 0.8, 1.2, 0.7]])
    turned = replace(scenarios, pose=pose, table=table)
    parts = by_gid(draw_table_top(turned, torch.ones(1), footprint=(-0.1, 0.5, -0.2, 0.3)))
    outline = parts["robots"].get_paths()[0].vertices
    # Turned to the left by 90°, its front points along y and its left along -x.
    assert outline.min(0) == pytest.approx([0.9, -2.3], abs=1e-5)
    assert outline.max(0) == pytest.approx([1.5, -1.8], abs=1e-5)
    corners = parts["table"].get_xy()
    assert corners.min(0) == pytest.approx([-0.9, -0.1], abs=1e-5)
    assert corners.max(0) == pytest.approx([-0.1, 1.1], abs=1e-5)


def test_everything_is_within_the_axes() -> None:
    scenarios, succeeded, targets = some()
    axes = draw_table_top(scenarios, succeeded, targets).axes[0]
    (x1, x0), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    low = torch.cat([scenarios.pose[:, :2] - 0.36, scenarios.object]).amin(0)
    high = torch.cat([scenarios.pose[:, :2] + 0.36, scenarios.object]).amax(0)
    assert x0 < low[1] < high[1] < x1
    assert y0 < low[0] < high[0] < y1


def test_many_tables_are_all_drawn_and_none_at_all_is_fine() -> None:
    scenarios = random_scenarios("far", 2, seeded(2))
    table = scenarios.table.clone()
    table[1, 0] = 0.3
    figure = draw_table_top(replace(scenarios, table=table), torch.ones(2))
    assert sum(p.get_gid() == "table" for p in figure.axes[0].patches) == 2
    assert not figure.axes[0].texts
    empty = draw_table_top(scenarios[:0], torch.zeros(0))
    assert empty.axes[0].get_title() == "0 of 0 reached"


def test_wrong_shapes_are_refused() -> None:
    scenarios = stage_scenarios("near")
    with pytest.raises(DataError, match="5 scenarios with results of shape"):
        draw_table_top(scenarios, torch.ones(4))
    with pytest.raises(DataError, match="targets of shape"):
        draw_table_top(scenarios, torch.ones(5), torch.ones(6))


def test_scenes_have_a_panel_each_in_one_scale() -> None:
    scenarios = cluttered_scenarios(7, seeded(0))
    succeeded = torch.arange(7) < 5
    figure = draw_scenes(scenarios, succeeded, title="S1")
    assert figure.get_suptitle().startswith("S1: 5 of 7 reached; panels ")
    assert len(figure.axes) == 7
    spans = {
        round(float(np.ptp(limits())), 5)
        for a in figure.axes
        for limits in (a.get_xlim, a.get_ylim)
    }
    assert len(spans) == 1
    assert float(figure.get_suptitle().split()[-3]) == pytest.approx(spans.pop(), abs=0.05)
    there = scenarios.obstacles[:, 0, 3] > 0
    assert 0 < int(there.sum()) < 7
    for i, axes in enumerate(figure.axes):
        shapes = {p.get_gid(): p.get_xy()[:4] for p in axes.patches if p.get_gid()}
        marks = {c.get_gid(): c for c in axes.collections if c.get_gid()}
        assert set(shapes) == {"table", "obstacle"} if there[i] else {"table"}
        assert set(marks) == {"robots", "reached" if i < 5 else "missed"}
        table = corners(scenarios.table[i, :5]).flip(1).numpy()
        assert np.allclose(shapes["table"], table, atol=1e-5)
        if there[i]:
            box = corners(scenarios.obstacles[i, 0]).flip(1).numpy()
            assert np.allclose(shapes["obstacle"], box, atol=1e-5)
        everything = np.concatenate([*shapes.values(), marks["robots"].get_paths()[0].vertices])
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        assert right < everything[:, 0].min() < everything[:, 0].max() < left
        assert bottom < everything[:, 1].min() < everything[:, 1].max() < top


def test_obstacles_are_drawn_beside_one_table_too() -> None:
    obstacle = torch.tensor([[[1.0, 0.0, 0.3, 0.4, 0.5]], [[0.0] * 5]])
    scenarios = replace(stage_scenarios("near", 2), obstacles=obstacle)
    patches = draw_table_top(scenarios, torch.ones(2)).axes[0].patches
    assert [p.get_gid() for p in patches].count("obstacle") == 1


def test_scenes_without_results_are_refused() -> None:
    scenarios = stage_scenarios("near")
    with pytest.raises(DataError, match="5 scenarios with results of shape"):
        draw_scenes(scenarios, torch.ones(4))
    with pytest.raises(DataError, match="at least one scenario"):
        draw_scenes(scenarios[:0], torch.ones(0))


def test_placements_at_one_table_are_in_one_picture() -> None:
    scenarios, succeeded, targets = some()
    figure = draw_placements(scenarios, succeeded, targets, title="S2")
    alone = draw_table_top(scenarios, succeeded, targets, title="S2")
    assert len(figure.axes) == 1
    assert figure.axes[0].get_title() == alone.axes[0].get_title()
    for gid, part in by_gid(alone).items():
        drawn = by_gid(figure)[gid]
        if gid in ("reached", "missed", "targets"):
            assert np.array_equal(drawn.get_offsets(), part.get_offsets())
    wide = draw_placements(scenarios, succeeded, targets, footprint=(-1, 1, -1, 1))
    outline = by_gid(wide)["robots"].get_paths()[0].vertices
    assert np.ptp(outline, 0).min() == pytest.approx(2, abs=0.9)
    none = draw_placements(scenarios[:0], succeeded[:0], targets[:0])
    assert none.axes[0].get_title() == "0 of 0 reached"


def test_placements_at_several_tables_have_a_panel_each() -> None:
    scenarios = cluttered_scenarios(7, seeded(0))
    none = torch.zeros(7, dtype=torch.bool)
    figure = draw_placements(scenarios, torch.arange(7) < 5, none, title="S1")
    assert len(figure.axes) == 7
    assert figure.get_suptitle().startswith("S1: 5 of 7 reached")


def test_of_many_placements_tests_and_misses_are_drawn_first() -> None:
    scenarios = cluttered_scenarios(60, seeded(0))
    succeeded = torch.ones(60, dtype=torch.bool)
    targets = torch.zeros(60, dtype=torch.bool)
    succeeded[[3, 50]] = False
    targets[[11, 50, 59]] = True
    figure = draw_placements(scenarios, succeeded, targets)
    assert len(figure.axes) == SCENES
    assert figure.get_suptitle().startswith(f"{SCENES - 2} of {SCENES} reached")
    drawn = torch.stack(
        [
            torch.tensor(mark.get_offsets()[0])
            for axes in figure.axes
            for mark in axes.collections
            if mark.get_gid() in ("reached", "missed")
        ]
    ).float()
    place = torch.cdist(drawn, scenarios.object.flip(1)).argmin(1)
    assert {3, 11, 50, 59} <= set(place.tolist())
    assert torch.equal(place, place.unique())  # in their order, none twice
    gaps = place.diff()
    assert gaps.max() <= 5  # the others evenly spread


def test_only_misses_are_drawn_where_there_are_more_than_fit() -> None:
    scenarios = cluttered_scenarios(40, seeded(0))
    succeeded = torch.arange(40) >= 30
    figure = draw_placements(scenarios, succeeded, torch.zeros(40, dtype=torch.bool))
    assert figure.get_suptitle().startswith(f"0 of {SCENES} reached")
