"""The features of C: smooth, and blind to what cannot matter."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from stand_in import labelled

from cgtorch.tabletop.models.success import GraspClassifier, grasp_features, used_features


def test_gradients_equal_finite_differences():
    percept = torch.tensor(labelled(20, 1)[0], requires_grad=True)
    assert torch.autograd.gradcheck(grasp_features, (percept,))


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_distance_and_direction_give_the_object_back(x, y):
    percept = torch.tensor([0.3, 1.1, -0.6, 0.6, x, y, 0.74], dtype=torch.float64)
    f = grasp_features(percept)
    distance = f[4] / 4
    assert torch.allclose(distance * f[5:7] / 2, percept[4:6], atol=1e-5)


def test_sides_far_away_hardly_matter_and_obstacles_do_not():
    near = torch.tensor([0.3, 1.1, -0.6, 0.6, 0.5, 0.1, 0.74], dtype=torch.float64)
    far = near.clone()
    far[1] = 3.0
    assert float((grasp_features(far) - grasp_features(near)).abs().max()) < 0.03
    beside = torch.cat([near, torch.tensor([1.0, 1.3, -0.9, -0.4])])
    assert torch.equal(grasp_features(beside), grasp_features(near))


def test_the_height_counts_only_where_it_differs():
    percept = torch.tensor(labelled(50, 1)[0])
    assert grasp_features(percept).shape == (50, 8)
    assert used_features(percept) == 7
    percept[:, 6] = torch.linspace(0.6, 0.9, 50)
    assert used_features(percept) == 8
    assert torch.allclose(grasp_features(percept)[:, 7], 3 * percept[:, 6])


def seen(x, y, yaw, a, b, placed):
    """A percept with the table's yaw, from a plain rectangle."""
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    w, h = a * c + b * s, a * s + b * c
    box = [x - w / 2, x + w / 2, y - h / 2, y + h / 2]
    side = [a * math.cos(2 * yaw), a * math.sin(2 * yaw)]
    return torch.tensor([*box, *placed, 0.7, *side], dtype=torch.float64)


lengths = st.floats(0.6, 1.4)


@given(st.floats(0, 1.5), st.floats(-0.5, 0.5), st.floats(-3.14, 3.14), lengths, lengths)
def test_edges_are_those_in_front_of_the_robot(away, aside, yaw, a, b):
    """A robot before the edge across the table's own x axis, wherever that points."""
    c, s = math.cos(yaw), math.sin(yaw)
    out = away + a / 2 + 0.01
    x, y = -c * out + s * aside * b / 2, -s * out - c * aside * b / 2
    placed = (x + c * (a / 2 - 0.1), y + s * (a / 2 - 0.1))
    f = grasp_features(seen(x, y, yaw, a, b, placed))
    assert f.shape == (10,)
    first = 0.5 * math.tanh((away + 0.01) / 0.5)
    assert float(f[4]) == pytest.approx(first, abs=1e-6)
    assert float(f[6]) == pytest.approx(0.1, abs=1e-6)
    assert f[8:].tolist() == pytest.approx([0.5 * c, 0.5 * s], abs=1e-6)
    assert float(f[5]) < float(f[4])


@given(st.floats(-3.14, 3.14), lengths, lengths)
def test_either_end_of_a_side_and_either_side_give_the_same_features(yaw, a, b):
    one = grasp_features(seen(1.0, 0.2, yaw, a, b, (0.8, 0.1)))
    for other in (
        seen(1.0, 0.2, yaw + math.pi, a, b, (0.8, 0.1)),
        seen(1.0, 0.2, yaw + math.pi / 2, b, a, (0.8, 0.1)),
    ):
        ahead = one[4:6].sort(descending=True).values
        assert torch.allclose(grasp_features(other)[4:6], ahead, atol=1e-6)
        if float(one[4] - one[5]) > 1e-6:
            assert torch.allclose(grasp_features(other), one, atol=1e-6)


def test_gradients_with_the_yaw_equal_finite_differences():
    rows = [seen(1.0, 0.3 * i, 0.4 + 0.1 * i, 0.8, 1.1, (0.7, 0.2)) for i in range(4)]
    percept = torch.stack(rows).requires_grad_()
    assert torch.autograd.gradcheck(grasp_features, (percept,))


@pytest.mark.parametrize("size", [7, 9])
def test_obstacles_of_any_number_are_left_out(size):
    percept = torch.rand(4, 3, size)
    for boxes in (1, 2, 3):
        more = torch.cat([percept, torch.rand(4, 3, 4 * boxes)], -1)
        assert torch.equal(grasp_features(more), grasp_features(percept))


def test_features_of_a_box_are_its_sides_the_way_to_the_object_and_its_height():
    percept = torch.tensor([[0.3, 1.1, -0.6, 0.6, 0.3, -0.4, 0.7]] * 2, dtype=torch.float64)
    sides = [0.5 * math.tanh(x / 0.5) for x in (0.3, 1.1, -0.6, 0.6)]
    wanted = [*sides, 4 * 0.5, 2 * 0.6, -2 * 0.8, 3 * 0.7]
    for row in grasp_features(percept).tolist():
        assert row == pytest.approx(wanted)


def test_features_of_a_turned_table_are_two_edges_after_the_way_and_the_height():
    percept = seen(1.0, 0.9, 0.0, 0.8, 1.2, (0.7, 0.4))
    ahead = [0.5 * math.tanh(x / 0.5) for x in (0.6, 0.3)]  # of the edges at -x and at -y
    away = math.hypot(0.7, 0.4)
    polar = [4 * away, 2 * 0.7 / away, 2 * 0.4 / away, 3 * 0.7]
    wanted = [*polar, *ahead, 0.1, 0.1, -0.5, 0.0]
    assert grasp_features(percept).tolist() == pytest.approx(wanted)


def test_heights_that_differ_by_more_than_noise_are_used():
    percept = torch.tensor(labelled(50, 1)[0])
    for spread, used in ((0.019, 7), (0.021, 8)):
        percept[:, 6] = 0.7 + spread * torch.tensor([-1.0, 1.0]).repeat(25)
        assert used_features(percept) == used
    assert used_features(torch.rand(5, 9)) == used_features(torch.rand(5, 13)) == 10


def test_all_features_have_one_scale_and_constant_ones_that_of_one():
    percept = torch.tensor(labelled(60, 2)[0])
    model = GraspClassifier()
    rows = model.standardise(percept)
    features = grasp_features(percept)[:, :7]
    assert torch.equal(model.mean, features.mean(0))
    assert len(model.scale.unique()) == 1
    assert float(rows.square().mean()) == pytest.approx(1)
    torch.testing.assert_close(rows * model.scale + model.mean, features)
    still = model.standardise(percept[:1].expand(4, -1))
    assert model.scale.tolist() == [1.0] * 7
    assert still.abs().max() < 1e-12
