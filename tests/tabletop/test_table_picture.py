"""Scenes from above: marks where objects are, to scale; one picture, or a panel per scene."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from support import seeded

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.table_picture import (
    AROUND,
    BAD,
    FOOTPRINT,
    GOOD,
    LONGEST,
    MARGINS,
    PANEL,
    RIM,
    ROBOT,
    SCENES,
    TABLE,
    TARGET,
    _bounds,
    draw_placements,
    draw_scenes,
    draw_table_top,
)
from cgtorch.tabletop.world import (
    Scenarios,
    cluttered_scenarios,
    random_scenarios,
    stage_scenarios,
)
from cgtorch.tabletop.world.geometry import corners

NONE = torch.zeros(7, dtype=torch.bool)


def some() -> tuple[Scenarios, torch.Tensor, torch.Tensor]:
    scenarios = random_scenarios("perimeter", 30, seeded(0)).joined(stage_scenarios("right"))
    succeeded = torch.rand(35, generator=seeded(1)) < 0.7
    return scenarios, succeeded, torch.arange(35) >= 30


def parts_of(axes: Any) -> dict[str, Any]:
    return {a.get_gid(): a for a in (*axes.collections, *axes.patches) if a.get_gid()}


def drawn(figure: Any) -> dict[str, Any]:
    FigureCanvasAgg(figure).draw()
    return parts_of(figure.axes[0])


def test_every_object_is_where_it_stands_and_marks_differ_without_colour() -> None:
    scenarios, succeeded, targets = some()
    parts = drawn(draw_table_top(scenarios, succeeded, targets))
    for gid, chosen in (("reached", succeeded), ("missed", ~succeeded), ("targets", targets)):
        wanted = scenarios.object[chosen].flip(1).numpy()
        assert np.allclose(parts[gid].get_offsets(), wanted)
    assert len(parts["robots"].get_paths()) == 31  # the five share a start
    shapes = [len(parts[g].get_paths()[0].vertices) for g in ("reached", "missed")]
    assert shapes[0] != shapes[1]
    assert parts["targets"].get_sizes()[0] > 2 * parts["reached"].get_sizes()[0]
    assert len(parts["targets"].get_facecolors()) == 0  # a ring hides no mark
    order = [parts[gid].get_zorder() for gid in ("table", "robots", "reached", "missed", "targets")]
    assert order == sorted({*order})


def test_where_there_are_many_marks_are_smaller_and_robots_fainter() -> None:
    many = random_scenarios("perimeter", 200, seeded(3))
    for count, drawn_, size, fill in ((1, 1, 40, 0.12), (120, 60, 40, 0.0), (121, 41, 26, 0.0)):
        figure = draw_table_top(many[:count], torch.ones(count))
        parts = parts_of(figure.axes[0])
        assert parts["reached"].get_sizes().tolist() == [size]
        robots = parts["robots"]
        assert len(robots.get_paths()) == drawn_
        assert robots.get_edgecolors()[0][3] == pytest.approx(min(0.8, 8 / drawn_))
        assert robots.get_facecolors()[0][3] == fill


def test_a_picture_is_six_inches_long_with_room_around_everything() -> None:
    scenarios, succeeded, _ = some()
    figure = draw_table_top(scenarios, succeeded)
    left, right, bottom, top = MARGINS
    size = figure.get_size_inches()
    inside = size - (left + right, bottom + top)
    assert inside.max() == pytest.approx(LONGEST)
    (x0, y0), (x1, y1) = (bound.tolist() for bound in _bounds(scenarios, FOOTPRINT))
    axes = figure.axes[0]
    assert axes.get_xlim() == pytest.approx((y1 + AROUND / 2, y0 - AROUND / 2))
    assert axes.get_ylim() == pytest.approx((x0 - AROUND / 2, x1 + AROUND / 2))
    assert inside[0] / inside[1] == pytest.approx((y1 - y0 + AROUND) / (x1 - x0 + AROUND))
    sides = figure.subplotpars
    assert (sides.left * size[0], sides.bottom * size[1]) == pytest.approx((left, bottom))
    ends = (1 - sides.right) * size[0], (1 - sides.top) * size[1]
    assert ends == pytest.approx((right, top))
    turns = {text.get_text(): text.get_rotation() for text in axes.texts}
    assert turns == {"near": 0, "far": 0, "left": 90, "right": 270}


def test_title_legend_scale_orientation_and_edge_names() -> None:
    scenarios, succeeded, targets = some()
    figure = draw_table_top(scenarios, succeeded, targets, title="S2")
    axes = figure.axes[0]
    good, both = int(succeeded.sum()), int((succeeded & targets).sum())
    assert axes.get_title() == f"S2: {good} of 35 reached\n{both} of 5 test placements"
    names = {t.get_text() for t in figure.legends[0].get_texts()}
    assert {f"reached ({good})", f"missed ({35 - good})"} <= names
    plain = draw_table_top(scenarios, succeeded)
    assert plain.axes[0].get_title() == f"{good} of 35 reached"
    assert np.ptp(drawn(figure)["table"].get_xy(), 0) == pytest.approx([1.2, 0.8], abs=1e-6)
    origin, left, away = map(axes.transData.transform, ((0, 0), (1, 0), (0, 1)))
    assert left[0] - origin[0] == pytest.approx(-(away[1] - origin[1]), rel=1e-6)
    assert left[0] < origin[0]  # the robot's left is left
    places = {t.get_text(): np.array(t.get_position()) for t in axes.texts}
    assert set(places) == {"near", "left", "right", "far"}
    assert places["near"][1] < -0.4 < 0.4 < places["far"][1]
    assert places["right"][0] < -0.6 < 0.6 < places["left"][0]
    assert "(m)" in axes.get_xlabel()
    assert "(m)" in axes.get_ylabel()
    (x1, x0), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    low = torch.cat([scenarios.pose[:, :2] - 0.36, scenarios.object]).amin(0)
    high = torch.cat([scenarios.pose[:, :2] + 0.36, scenarios.object]).amax(0)
    assert x0 < low[1] < high[1] < x1
    assert y0 < low[0] < high[0] < y1


def test_lines_and_words_are_fine_and_nothing_hides_what_matters() -> None:
    scenarios, succeeded, targets = some()
    figure = draw_table_top(scenarios, succeeded, targets)
    axes, parts = figure.axes[0], drawn(figure)
    assert (figure.dpi, to_hex(figure.get_facecolor())) == (100, "#ffffff")
    for text in axes.texts:
        assert (text.get_ha(), text.get_va(), text.get_style()) == ("center", "center", "italic")
        assert (text.get_fontsize(), text.get_color()) == (10, "#7a6745")
        assert parts["table"].get_zorder() < text.get_zorder() < parts["reached"].get_zorder()
    assert (axes.title.get_fontsize(), axes.title.get_color()) == (11, TARGET)
    (legend,) = figure.legends
    assert (legend._ncols, legend.get_frame_on(), legend._loc) == (2, False, 8)  # lower center
    assert {text.get_fontsize() for text in legend.get_texts()} == {9}
    assert {"robot at its start", "test placements (5)"} <= {
        text.get_text() for text in legend.get_texts()
    }
    table = parts["table"]
    assert (to_hex(table.get_facecolor()), to_hex(table.get_edgecolor())) == (TABLE, RIM)
    assert table.get_linewidth() == pytest.approx(1.4)
    for gid, colour in (("reached", GOOD), ("missed", BAD)):
        mark = parts[gid]
        assert to_hex(mark.get_facecolor()[0]) == colour
        assert (to_hex(mark.get_edgecolor()[0]), mark.get_linewidths()) == ("#ffffff", [0.6])
    ring = parts["targets"]
    assert (to_hex(ring.get_edgecolor()[0]), ring.get_linewidths()) == (TARGET, [1.6])
    robots, headings = (c for c in axes.collections if len(c.get_paths()) == 31)
    for part in (robots, headings):
        assert to_hex(part.get_edgecolor()[0]) == ROBOT
        assert (part.get_linewidths(), part.get_zorder()) == ([0.9], 2)
    assert [line.get_color() for line in axes.get_xgridlines()[:1]] == ["#e6e6e6"]
    assert axes.get_xgridlines()[0].get_linewidth() == pytest.approx(0.6)
    assert axes.get_axisbelow()
    shown = {side: axes.spines[side].get_visible() for side in ("left", "bottom", "top", "right")}
    assert shown == {"left": True, "bottom": True, "top": False, "right": False}
    for axis in (axes.xaxis, axes.yaxis):
        assert np.diff(axis.get_majorticklocs()) == pytest.approx(0.5)
    blank = draw_table_top(scenarios[:0], NONE[:0])
    assert blank.get_size_inches().tolist() == pytest.approx([4.2, 4.2])
    assert not blank.legends


def test_a_turned_robot_and_a_turned_table() -> None:
    quarter = torch.pi / 2
    pose = torch.tensor([[-2.0, 1.0, quarter]])
    table = torch.tensor([[0.5, -0.5, quarter, 0.8, 1.2, 0.7]])
    turned = replace(stage_scenarios("near", 1), pose=pose, table=table)
    parts = drawn(draw_table_top(turned, torch.ones(1), footprint=(-0.1, 0.5, -0.2, 0.3)))
    outline, top = parts["robots"].get_paths()[0].vertices, parts["table"].get_xy()
    # Turned to the left by 90°, its front points along y and its left along -x.
    assert [*outline.min(0), *outline.max(0)] == pytest.approx([0.9, -2.3, 1.5, -1.8], abs=1e-5)
    assert [*top.min(0), *top.max(0)] == pytest.approx([-0.9, -0.1, -0.1, 1.1], abs=1e-5)


def test_many_tables_and_obstacles_are_drawn_and_none_at_all_is_fine() -> None:
    scenarios = random_scenarios("far", 2, seeded(2))
    table = scenarios.table.clone()
    table[1, 0] = 0.3
    axes = draw_table_top(replace(scenarios, table=table), torch.ones(2)).axes[0]
    assert [p.get_gid() for p in axes.patches].count("table") == 2
    assert not axes.texts
    obstacle = torch.tensor([[[1.0, 0.0, 0.3, 0.4, 0.5]], [[0.0] * 5]])
    blocked = replace(stage_scenarios("near", 2), obstacles=obstacle)
    patches = draw_table_top(blocked, torch.ones(2)).axes[0].patches
    assert [p.get_gid() for p in patches].count("obstacle") == 1
    for draw in (draw_table_top, draw_placements):
        empty = draw(scenarios[:0], NONE[:0], NONE[:0])
        assert empty.axes[0].get_title() == "0 of 0 reached"


def test_wrong_shapes_are_refused() -> None:
    scenarios = stage_scenarios("near")
    for draw in (draw_table_top, draw_scenes):
        with pytest.raises(DataError, match="5 scenarios with results of shape"):
            draw(scenarios, torch.ones(4))
    with pytest.raises(DataError, match="targets of shape"):
        draw_table_top(scenarios, torch.ones(5), torch.ones(6))
    with pytest.raises(DataError, match="at least one scenario"):
        draw_scenes(scenarios[:0], torch.ones(0))


def test_placements_at_several_tables_have_a_panel_each_in_one_scale() -> None:
    scenarios = cluttered_scenarios(7, seeded(0))
    figure = draw_placements(scenarios, torch.arange(7) < 5, NONE, title="S1")
    assert figure.get_suptitle().startswith("S1: 5 of 7 reached; panels ")
    assert len(figure.axes) == 7
    assert figure.get_size_inches().tolist() == pytest.approx([4 * PANEL, 2 * PANEL + 0.5])
    assert {a.get_aspect() for a in figure.axes} == {1}
    assert not any(len(a.get_xticks()) or len(a.get_yticks()) for a in figure.axes)
    two = draw_scenes(scenarios[:2], torch.ones(2))
    assert two.get_size_inches().tolist() == pytest.approx([2 * PANEL, PANEL + 0.5])
    assert [(a.get_subplotspec().rowspan.start, a.get_subplotspec().colspan.start)
            for a in figure.axes] == [(i // 4, i % 4) for i in range(7)]  # fmt: skip
    limits = [limit for a in figure.axes for limit in (a.get_xlim(), a.get_ylim())]
    (span,) = {round(float(np.ptp(limit)), 5) for limit in limits}
    assert float(figure.get_suptitle().split()[-3]) == pytest.approx(span, abs=0.05)
    there = scenarios.obstacles[:, 0, 3] > 0
    assert 0 < int(there.sum()) < 7
    for i, axes in enumerate(figure.axes):
        parts = parts_of(axes)
        wanted = {"table", "robots", "reached" if i < 5 else "missed"}
        assert set(parts) == wanted | ({"obstacle"} if there[i] else set())
        boxes = {"table": scenarios.table[i, :5], "obstacle": scenarios.obstacles[i, 0]}
        outlines = [parts["robots"].get_paths()[0].vertices]
        for name in boxes.keys() & parts.keys():
            outlines.append(parts[name].get_xy()[:4])
            assert np.allclose(outlines[-1], corners(boxes[name]).flip(1).numpy(), atol=1e-5)
        everything = np.concatenate(outlines)
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        assert right < everything[:, 0].min() < everything[:, 0].max() < left
        assert bottom < everything[:, 1].min() < everything[:, 1].max() < top


def test_placements_at_one_table_are_in_one_picture() -> None:
    scenarios, succeeded, targets = some()
    figure = draw_placements(scenarios, succeeded, targets, title="S2")
    alone = draw_table_top(scenarios, succeeded, targets, title="S2")
    assert len(figure.axes) == 1
    assert figure.axes[0].get_title() == alone.axes[0].get_title()
    found, wanted = drawn(figure), drawn(alone)
    for gid in ("reached", "missed", "targets"):
        assert np.array_equal(found[gid].get_offsets(), wanted[gid].get_offsets())
    wide = draw_placements(scenarios, succeeded, targets, footprint=(-1, 1, -1, 1))
    outline = drawn(wide)["robots"].get_paths()[0].vertices
    assert np.ptp(outline, 0).min() == pytest.approx(2, abs=0.9)


def test_of_many_placements_tests_and_misses_are_drawn_first() -> None:
    scenarios = cluttered_scenarios(60, seeded(0))
    succeeded, targets = torch.ones(60, dtype=torch.bool), torch.zeros(60, dtype=torch.bool)
    succeeded[[3, 50]] = False
    targets[[11, 50, 59]] = True
    figure = draw_placements(scenarios, succeeded, targets)
    assert len(figure.axes) == SCENES
    assert figure.get_suptitle().startswith(f"{SCENES - 2} of {SCENES} reached")
    marks = [part for axes in figure.axes for gid, part in parts_of(axes).items()
             if gid in ("reached", "missed")]  # fmt: skip
    at = torch.tensor(np.array([mark.get_offsets()[0] for mark in marks])).float()
    place = torch.cdist(at, scenarios.object.flip(1)).argmin(1)
    assert {3, 11, 50, 59} <= set(place.tolist())
    assert torch.equal(place, place.unique())  # in their order, none twice
    assert place.diff().max() <= 5  # the others evenly spread
    misses = draw_placements(scenarios, torch.arange(60) >= 30, torch.zeros_like(targets))
    assert misses.get_suptitle().startswith(f"0 of {SCENES} reached")
