"""The features of C: smooth, and blind to what cannot matter."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from tabletop import labelled

from cgtorch.models.grasp_features import grasp_features


def test_gradients_equal_finite_differences():
    percept = torch.tensor(labelled(20, 1)[0], requires_grad=True)
    assert torch.autograd.gradcheck(grasp_features, (percept,))


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_distance_and_direction_give_the_object_back(x, y):
    percept = torch.tensor([0.3, 1.1, -0.6, 0.6, x, y, 0.74], dtype=torch.float64)
    f = grasp_features(percept)
    distance = f[4] / 4
    assert torch.allclose(distance * f[5:7] / 2, percept[4:6], atol=1e-5)


def test_sides_far_away_and_the_height_hardly_matter():
    near = torch.tensor([0.3, 1.1, -0.6, 0.6, 0.5, 0.1, 0.74], dtype=torch.float64)
    far, high = near.clone(), near.clone()
    far[1], high[6] = 3.0, 1.0
    assert float((grasp_features(far) - grasp_features(near)).abs().max()) < 0.03
    assert torch.equal(grasp_features(high), grasp_features(near))


def test_percepts_of_another_size_stay_as_they_are():
    percept = torch.rand(4, 3, 2)
    assert grasp_features(percept) is percept
