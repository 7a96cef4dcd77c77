"""Shapes around meshes hold all of them, and are about as small as they can be."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from points_outside import outside
from trimesh.transformations import random_rotation_matrix, rotation_matrix, translation_matrix

from cgtorch.tabletop.kinematics import shapes
from cgtorch.tabletop.kinematics.shapes import (
    MAX_FLATNESS,
    ROUNDING,
    SEARCHED,
    THIN,
    Shape,
    _box,
    _box_axes,
    _circle,
    _hull,
    _outermost,
    _outermost_flat,
    _right_handed,
    _round,
    _shape,
    _sides,
    capsule,
    fitted,
)

SLACK = 1e-9  # m, of rounding


def farthest(fit, points):
    """How far the worst of points is from all shapes, m."""
    return float(np.min([outside(shape, points) for shape in fit.shapes], axis=0).max())


def on_surface(mesh, count=500):
    if mesh.area == 0:
        return mesh.vertices
    return np.asarray(trimesh.sample.sample_surface(mesh, count, seed=0)[0])


def random_mesh(seed, kind):
    """Some mesh: a cloud's triangles, boxes put together, a flat or a thin one, a heavy lump."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-2.5, 0.5)
    if kind == "boxes":
        parts = [
            trimesh.creation.box(rng.uniform(0.05, 1, 3), random_rotation_matrix(rng.random(3)))
            for _ in range(rng.integers(1, 4))
        ]
        for part in parts:
            part.apply_translation(rng.normal(size=3))
        return trimesh.util.concatenate(parts).apply_scale(size)
    points = rng.normal(size=(rng.integers(3, 60), 3)) * rng.uniform(0.1, 1, 3)
    if kind == "flat":
        points[:, 2] = 0
    if kind == "line":
        points[:, 1:] = 0
    if kind == "point":
        points[:] = points[0]
    points = points @ random_rotation_matrix(rng.random(3))[:3, :3].T
    faces = rng.integers(0, len(points), size=(rng.integers(1, 80), 3))
    return trimesh.Trimesh(size * points, faces, process=False)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["cloud", "boxes", "flat", "line", "point"]))
def test_every_vertex_and_all_of_the_surface_lie_inside(seed, kind):
    mesh = random_mesh(seed, kind)
    used = mesh.vertices[np.unique(mesh.faces)]
    mesh = trimesh.Trimesh(used, np.searchsorted(np.unique(mesh.faces), mesh.faces), process=False)
    fit = fitted(mesh)
    assert 1 <= len(fit.shapes) <= shapes.MOST_PARTS
    assert farthest(fit, mesh.vertices) <= SLACK
    assert farthest(fit, on_surface(mesh)) <= SLACK
    assert all(np.allclose(s.pose[:3, :3] @ s.pose[:3, :3].T, np.eye(3)) for s in fit.shapes)
    assert all(np.linalg.det(s.pose[:3, :3]) > 0.99 for s in fit.shapes)
    assert all(0 < size < 1e3 for shape in fit.shapes for size in shape.sizes)


@pytest.mark.parametrize(
    ("mesh", "kind", "ratio"),
    [
        (trimesh.creation.box((0.3, 0.1, 0.05)), "box", 1.001),
        (trimesh.creation.cylinder(0.05, 0.2, sections=64), "cylinder", 1.01),
        (trimesh.creation.capsule(0.3, 0.05, count=(48, 48)), "capsule", 1.02),
        (trimesh.creation.icosphere(4, 0.1), "sphere", 1.02),
    ],
)
def test_a_mesh_of_a_shape_becomes_that_shape(mesh, kind, ratio):
    turned = (
        mesh.copy().apply_transform(rotation_matrix(0.7, [1, 2, 3])).apply_translation([3, 2, 1])
    )
    fit = fitted(turned)
    assert [shape.kind for shape in fit.shapes] == [kind]
    assert 0.999 < fit.ratio < ratio
    assert farthest(fit, turned.vertices) <= SLACK


def test_what_is_concave_is_split():
    arms = [
        trimesh.creation.box((0.5, 0.05, 0.05), translation_matrix([0.25, 0, 0])),
        trimesh.creation.box((0.05, 0.05, 0.5), translation_matrix([0, 0, 0.25])),
    ]
    fit = fitted(trimesh.util.concatenate(arms))
    assert len(fit.shapes) > 1
    assert sum(shape.volume for shape in fit.shapes) < 1.3 * sum(arm.volume for arm in arms)
    assert fit.ratio < 0.5  # of the convex hull


def test_a_mesh_of_very_many_triangles_is_taken_for_its_hull():
    ball = trimesh.creation.icosphere(6, 0.1)
    assert len(ball.faces) > shapes.MOST_CUT
    fit = fitted(ball)
    assert farthest(fit, ball.vertices) <= SLACK
    assert fit.ratio < 1.02


@pytest.mark.parametrize(
    ("shape", "mesh"),
    [
        (Shape("box", np.eye(4), (0.3, 0.2, 0.1)), trimesh.creation.box((0.3, 0.2, 0.1))),
        (Shape("sphere", np.eye(4), (0.1,)), trimesh.creation.icosphere(4, 0.1)),
        (
            Shape("cylinder", np.eye(4), (0.1, 0.3)),
            trimesh.creation.cylinder(0.1, 0.3, sections=128),
        ),
        (
            Shape("capsule", np.eye(4), (0.1, 0.3)),
            trimesh.creation.capsule(0.3, 0.1, count=(64, 64)),
        ),
    ],
)
def test_distances_and_volumes_are_those_of_a_mesh_of_the_shape(shape, mesh):
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (300, 3))
    _, away, _ = trimesh.proximity.closest_point_naive(mesh, points)
    away[trimesh.proximity.signed_distance(mesh, points) > 0] = 0
    np.testing.assert_allclose(outside(shape, points), away, atol=2e-3)
    assert math.isclose(shape.volume, mesh.volume, rel_tol=0.01)


def test_a_capsule_between_two_points():
    start, end = np.array([0.1, 0.2, 0.3]), np.array([0.4, -0.2, 0.3])
    shape = capsule(start, end, 0.05)
    assert (shape.kind, shape.sizes) == ("capsule", (0.05, pytest.approx(0.5)))
    away = outside(shape, np.stack([start, end, (start + end) / 2 + [0, 0, 0.07]]))
    np.testing.assert_allclose(away, [0, 0, 0.02], atol=1e-12)
    assert capsule(start, start, 0.05).kind == "sphere"


CORNERS = np.array(np.meshgrid((0.5, 1.5), (1.0, 3.0), (1.0, 5.0))).reshape(3, -1).T
"""Of a box of 1, 2 and 4 m around (1, 2, 3)."""


def test_a_box_and_what_is_round_hold_all_corners_and_hardly_more():
    box = _box(CORNERS, np.eye(3))
    np.testing.assert_allclose(box.pose[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(box.sizes, np.array([1, 2, 4]) + 2 * ROUNDING, atol=1e-12)
    flat = _box(CORNERS * [0, 1, 1], np.eye(3))
    assert flat.sizes[0] == pytest.approx(max(THIN, 4 / MAX_FLATNESS) + 2 * ROUNDING)
    radius = math.hypot(0.5, 1) + ROUNDING
    cylinder, round_ = _round(CORNERS, np.eye(3))
    assert cylinder.kind == "cylinder"
    assert cylinder.sizes == pytest.approx((radius, 4 + 2 * ROUNDING), abs=1e-9)
    np.testing.assert_allclose(cylinder.pose[:3, 3], [1, 2, 3], atol=1e-9)
    assert round_.kind == "capsule"
    bulge = math.sqrt(radius**2 - (radius - ROUNDING) ** 2)  # of its ends over the corners
    assert round_.sizes == pytest.approx((radius, 4 - 2 * bulge + 2 * ROUNDING), abs=1e-9)
    np.testing.assert_allclose(round_.pose[:3, 3], [1, 2, 3], atol=1e-9)
    short = _round(np.concatenate([CORNERS * [1, 1, 0], [[1, 2, 0]]]), np.eye(3))[1]
    assert short.kind == "sphere"
    assert short.sizes == pytest.approx((radius,), abs=1e-6)
    turned = np.eye(3)[:, [1, 2, 0]]  # z leads along x
    along, _ = _round(CORNERS, turned)
    assert along.sizes == pytest.approx((math.hypot(1, 2) + ROUNDING, 1 + 2 * ROUNDING), abs=1e-6)
    np.testing.assert_allclose(along.pose[:3, 3], [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(_circle(np.array([[1.0, 2.0], [3.0, 2.0]])), [2, 2])
    np.testing.assert_allclose(_circle(np.array([[1.0, 2.0]])), [1, 2])


@pytest.mark.parametrize("long", [0, 1, 2])
def test_what_is_round_lies_along_the_longest_side_where_no_cylinder_is_found(long, monkeypatch):
    monkeypatch.setattr(shapes, "_cylinder_axes", lambda points: None)
    monkeypatch.setattr(shapes, "_box_axes", lambda points: (np.eye(3), long))
    points = np.roll(trimesh.creation.capsule(0.3, 0.05, count=(24, 24)).vertices, long - 2, axis=1)
    found = _shape(points)
    assert found.kind == "capsule"
    assert found.sizes == pytest.approx((0.05, 0.3), abs=2e-3)
    np.testing.assert_allclose(np.abs(found.pose[:3, 2]), np.eye(3)[long])
    assert np.linalg.det(found.pose[:3, :3]) == pytest.approx(1)


def test_of_many_corners_those_are_looked_at_that_are_outermost_in_even_directions():
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(20_000, 3)), rng.normal(size=(3000, 3))
    ball, ways = (each / np.linalg.norm(each, axis=1)[:, None] for each in drawn)
    few = _outermost(ball)
    assert 0.9 * SEARCHED < len(few) <= SEARCHED
    assert np.arccos((ways @ few.T).max(axis=1)).max() < 0.27  # rad to the next
    assert _outermost(few) is few
    circle = ball[:, :2] / np.linalg.norm(ball[:, :2], axis=1)[:, None]
    few = _outermost_flat(circle)
    assert len(few) == SEARCHED
    assert np.arccos((circle[:3000] @ few.T).max(axis=1).clip(max=1)).max() < 0.033


@pytest.mark.parametrize("lost", [0, 1])
@pytest.mark.parametrize("nothing", [None, trimesh.Trimesh()])
def test_a_cut_has_two_pieces_or_is_none(lost, nothing, monkeypatch):
    brick = trimesh.creation.box((0.3, 0.2, 0.1))
    one, other = shapes._cut(brick)
    assert one.volume + other.volume <= brick.volume + 1e-9
    left = iter(nothing if k == lost else piece for k, piece in enumerate((one, other)))
    monkeypatch.setattr(trimesh.Trimesh, "slice_plane", lambda *about: next(left))
    assert shapes._cut(brick) == []


def test_what_is_flat_has_the_hull_of_a_thin_box():
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0], [1, 0.5, 0]]) + 3
    found, volume = _hull(corners)
    thick = 2 / MAX_FLATNESS
    assert volume == pytest.approx(2 * thick)
    assert found.shape == (8, 3)
    np.testing.assert_allclose(found.min(axis=0), [3, 3, 3 - thick / 2])
    np.testing.assert_allclose(found.max(axis=0), [5, 4, 3 + thick / 2])
    thin = np.concatenate([corners, corners + np.array([0, 0, THIN / 2])])
    assert _hull(thin)[1] == pytest.approx(2 * thick)
    small, volume = _hull(corners[:1])
    assert volume == pytest.approx(THIN**3)
    np.testing.assert_allclose(np.ptp(small, axis=0), THIN)
    cube, volume = _hull(CORNERS)
    assert (len(cube), volume) == (8, pytest.approx(8.0))


@pytest.mark.parametrize("first", [0, 1])
def test_the_part_that_fits_worst_is_cut_first(first, monkeypatch):
    sides = (0.5, 0.05, 0.05), (0.05, 0.05, 0.5)
    bars = [trimesh.creation.box(s, translation_matrix(np.array(s) / 2)) for s in sides]
    corner, brick = trimesh.util.concatenate(bars), trimesh.creation.box((0.3, 0.2, 0.1))
    brick.apply_translation([3, 0, 0])
    pieces, asked = [corner, brick][:: 1 - 2 * first], []

    def cut(mesh):
        asked.append(mesh)
        return [] if len(asked) > 1 else pieces

    monkeypatch.setattr(shapes, "_cut", cut)
    fit = fitted(trimesh.util.concatenate(pieces))
    assert asked[1] is corner
    assert len(fit.shapes) == 2


@pytest.mark.filterwarnings("ignore:invalid value encountered in divide")  # by no volume
@pytest.mark.parametrize("long", [0, 1])
def test_of_what_is_flat_the_longest_side_is_found_as_well(long):
    points = np.array([[0.0, 0, 0], [3, 0, 0], [0, 1, 0], [3, 1, 0], [1, 0.5, 0]])
    axes, found = _box_axes(np.roll(points, long, axis=1))
    np.testing.assert_allclose(np.abs(axes[:, found]), np.eye(3)[long], atol=0.2)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_axes_are_turned_to_be_right_handed():
    mirrored = np.diag([1.0, 1.0, -1.0])
    np.testing.assert_array_equal(_right_handed(mirrored), np.eye(3))
    np.testing.assert_array_equal(_right_handed(np.eye(3)), np.eye(3))


def test_a_plane_has_points_on_both_sides_and_where_edges_cross_it():
    points = np.array([[0.0, 0, 0], [4.0, 4, 0], [1.0, 8, 0]])
    edges = np.array([[0, 1], [1, 2], [2, 0]])
    above, below = _sides(points, edges, 0, 2.0)
    crossing = [[2, 2, 0], [2, pytest.approx(8 - 4 / 3), 0]]
    assert above.tolist() == [[4, 4, 0], *crossing]
    assert below.tolist() == [[0, 0, 0], [1, 8, 0], *crossing]
    at, none = _sides(points, edges, 1, 0.0)
    assert (len(at), len(none)) == (3, 0)
