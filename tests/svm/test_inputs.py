"""Difficult data: the right answer, or one clear error."""

import warnings

import numpy as np
import pytest
import sklearn.svm
import torch

from cgtorch.ground.errors import DataError, ModelError, SettingsError
from cgtorch.svm import SVC, SVR

RNG = np.random.default_rng(0)
X = RNG.standard_normal((40, 3))
Y = (X[:, 0] > 0).astype(int)


def with_probabilities(model):
    """The machine with some Platt parameters."""
    model.platt = torch.tensor([-1.5, 0.2]).double()
    return model


@pytest.mark.parametrize(
    ("model", "x", "y", "error", "says"),
    [
        (SVC(), X, np.ones(40), DataError, "1 classes"),
        (SVC(), X, np.arange(40), DataError, "40 classes"),
        (SVC(), np.where(X > 2, np.nan, X), Y, DataError, "NaN"),
        (SVR(), X, np.full(40, np.inf), DataError, "infinite"),
        (SVC(), X, Y[:-1], DataError, "one label per row"),
        (SVR(), X, Y[:-1], DataError, "one target per row"),
        (SVR(), X[:0], Y[:0], DataError, "at least one row"),
        (SVR(), X[:, 0], Y, DataError, "shape"),
        (SVR(), np.array([["a"]]), Y, DataError, "not an array of numbers"),
        (SVC(C=0), X, Y, SettingsError, "C is 0"),
        (SVR(C=[1.0, 2.0]), X, Y, SettingsError, "2 values for 1 outputs"),
        (SVR(epsilon=-1.0), X, Y, SettingsError, "epsilon is -1"),
        (SVC(gamma="huge"), X, Y, SettingsError, "huge"),
        (SVR(), X * 1e200, Y, DataError, "non-finite"),
        (SVR(), [], [], DataError, "at least one row"),
        (SVR(), X[:, :0], Y, DataError, "at least one row"),
        (SVR(), X * 1j, Y, DataError, "complex128"),
        (SVR(), torch.tensor(X) * 1j, Y, DataError, "complex128"),
        (SVR(), [[1.0], [2.0, 3.0]], [1, 2], DataError, "not an array of numbers"),
        (SVC(), X, Y.astype(str), DataError, "not an array of numbers"),
        (SVR(), X, np.zeros((40, 2, 2)), DataError, "one target per row"),
        (SVR(), X[:1], [], DataError, "one target per row"),
        (SVC(), X[:1], Y[:1], DataError, "1 classes"),
        (SVC(gamma=0), X, Y, SettingsError, "gamma is 0"),
        (SVC(gamma=None), X, Y, SettingsError, "gamma is None"),
        (SVC(C="much"), X, Y, SettingsError, "C is 'much'"),
        (SVC(C=np.nan), X, Y, SettingsError, "C is nan"),
    ],
)
def test_bad_input_is_one_clear_error(model, x, y, error, says):
    with pytest.raises(error, match=says) as caught:
        model.fit(x, y)
    assert "\n" not in str(caught.value)
    assert not model.fitted


def test_a_million_rows_are_refused_with_the_memory_they_would_take():
    rows = torch.zeros(1, 2).expand(1_000_000, 2)
    with pytest.raises(DataError, match=r"would take 36000\.0 GB.*at most 10922 rows"):
        SVR().fit(rows, torch.arange(1_000_000) % 2)


def test_an_unfitted_model_says_so():
    with pytest.raises(ModelError, match="fit"):
        SVR()(torch.zeros(1, 3))
    with pytest.raises(ModelError, match="no probabilities"):
        SVC().fit(X, Y)(torch.zeros(1, 3))
    with pytest.raises(DataError, match="2 features"):
        SVC().fit(X, Y).predict(X[:, :2])


def test_duplicates_and_constant_features_change_nothing():
    plain = SVC(3.0, gamma=0.5).fit(X, Y).decision_function(X)
    wide = np.concatenate([X, np.full((40, 1), 7.0)], 1)
    constant = SVC(3.0, gamma=0.5).fit(wide, Y).decision_function(wide)
    np.testing.assert_allclose(constant, plain, atol=1e-6)
    twice = SVC(1.5, gamma=0.5).fit(np.tile(X, (2, 1)), np.tile(Y, 2)).decision_function(X)
    np.testing.assert_allclose(twice, plain, atol=1e-4)


def test_constant_features_one_row_and_targets_inside_the_tube_give_a_constant():
    model = SVR(epsilon=0.1).fit(np.ones((10, 2)), np.arange(10.0))
    assert 3.9 < model.predict(np.ones((1, 2)))[0] < 5.1
    assert SVR().fit(X[:1], [3.0]).predict(X).tolist() == pytest.approx([3.0] * 40, abs=0.11)
    flat = SVR(epsilon=2.0).fit(X, X[:, 0] * 0.1)
    assert np.ptp(flat.predict(X)) == 0


@pytest.mark.parametrize(
    "given",
    [
        X.astype(np.float32),
        X.astype(">f8"),
        np.asfortranarray(X),
        X[::-1].copy()[::-1],
        np.repeat(X, 2, axis=0)[::2],
        X.tolist(),
        torch.tensor(X),
        torch.tensor(X).float(),
        torch.tensor(X, requires_grad=True),
        list(torch.tensor(X)),
    ],
)
def test_every_kind_of_array_gives_the_same_model(given):
    expected = SVR(2.0, gamma=0.4).fit(X, Y).predict(X)
    values = SVR(2.0, gamma=0.4).fit(given, torch.tensor(Y > 0)).predict(X)
    np.testing.assert_allclose(values, expected, atol=1e-5)


def test_read_only_arrays_are_read_without_a_warning():
    x = X.copy()
    x.setflags(write=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SVC().fit(x, Y).predict(x)


@pytest.mark.parametrize("dtype", [bool, np.int8, np.uint8, np.int64])
def test_whole_numbers_and_truth_values_are_numbers(dtype):
    x, y = (X > 0).astype(dtype), Y.astype(dtype)
    oracle = sklearn.svm.SVC(C=2.0, tol=1e-8).fit(x.astype(float), y.astype(int))
    model = SVC(2.0).fit(x, y)
    np.testing.assert_allclose(
        model.decision_function(x), oracle.decision_function(x.astype(float)), atol=1e-4
    )
    assert np.array_equal(model.predict(x), oracle.predict(x.astype(float)))


def test_rows_of_any_kind_and_shape_come_back_in_kind():
    model = with_probabilities(SVC().fit(torch.tensor(X), torch.tensor(Y)))
    assert isinstance(model.predict(X), np.ndarray)
    assert isinstance(model.predict(torch.tensor(X)), torch.Tensor)
    assert model.predict(X[7]).shape == ()
    assert model(torch.tensor(X[7])).tolist() == model(torch.tensor(X))[7].tolist()
    assert model(torch.tensor(X).reshape(4, 10, 3)).shape == (4, 10)
    with pytest.raises(DataError, match="no features"):
        model(torch.tensor(1.0))
    with pytest.raises(DataError, match="NaN"):
        model.predict([[1.0, np.nan, 2.0]])
    words = SVC().fit(X, np.where(Y > 0, 5, -2))
    assert words.classes.tolist() == [-2, 5]
    assert set(words.predict(X).tolist()) == {-2.0, 5.0}


def test_forward_is_differentiable():
    model = SVR(2.0, gamma=0.4).fit(X, np.stack([X[:, 0] ** 2, X[:, 1]], 1))
    x = torch.tensor(X[:4], requires_grad=True)
    assert torch.autograd.gradcheck(model, (x,))
    chance = with_probabilities(SVC(2.0, gamma=0.4).fit(X, Y))
    assert torch.autograd.gradcheck(chance, (x,))


def test_values_are_those_of_the_definition():
    model = SVR(5.0, gamma=0.4).fit(X, np.stack([X[:, 0] ** 2, X[:, 1], X[:, 2]], 1))
    rows = torch.randn(5000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    plain = torch.exp(-0.4 * torch.cdist(rows, model.centres).square()) @ model.weights + model.bias
    assert torch.allclose(model(rows), plain, atol=1e-9)
    assert torch.allclose(model.float()(rows.float()).double(), plain, atol=1e-4)
    assert model(rows[:0]).shape == (0, 3)


def test_state_dict_is_complete():
    model = with_probabilities(SVC().fit(X, Y))
    copy = SVC()
    copy.load_state_dict(model.state_dict())
    assert torch.equal(copy(torch.tensor(X)), model(torch.tensor(X)))
    assert copy.support.tolist() == model.support.tolist()


def test_buffers_of_another_number_of_axes_or_none_are_no_state():
    machine = SVR().fit(np.arange(12.0).reshape(6, 2), np.arange(6.0))
    state = machine.state_dict()
    for name, value in (("bias", state["bias"][None]), ("centres", state["centres"][0])):
        with pytest.raises(RuntimeError, match=f"size mismatch for {name}"):
            SVR().load_state_dict({**state, name: value})
    with pytest.raises(RuntimeError, match="Missing key"):
        SVR().load_state_dict({name: state[name] for name in state if name != "bias"})
    SVR().load_state_dict(state)


def test_what_is_not_given_is_as_in_scikit_learn():
    for ours, theirs in ((SVC(), sklearn.svm.SVC()), (SVR(), sklearn.svm.SVR())):
        assert ours.C == theirs.C
        assert ours.gamma == theirs.gamma
    assert SVR().epsilon == sklearn.svm.SVR().epsilon


def test_before_a_fit_there_are_no_centres_and_no_probabilities():
    for model in (SVC(), SVR()):
        shapes = {name: tuple(value.shape) for name, value in model.state_dict().items()}
        none = {"centres": (0, 0), "weights": (0, 1), "support": (0,), "bias": (1,)}
        assert none.items() <= shapes.items()
        assert not model.fitted
        assert float(model.gamma_value) == 1
    assert SVC().classes.tolist() == [0, 1]
    assert np.isnan(SVC().platt.numpy()).all()
    assert bool(SVR().squeeze)


def test_learning_on_begins_with_what_was_learned(monkeypatch):
    begun = []
    start = SVR._start
    monkeypatch.setattr(SVR, "_start", lambda *given: begun.append(given) or start(*given))
    model = SVR([2.0], gamma=0.25, epsilon=0.05).fit(X[:30], X[:30, 0])
    assert not begun
    model.C, model.gamma, model.epsilon = 9.0, 9.0, 9.0  # which were not those of the fit
    model.learn_on(X, X[:, 0])
    assert len(begun) == 1
    assert (model.C, model.gamma, model.epsilon) == ([2.0], 0.25, [0.05])
    wanted = SVR([2.0], gamma=0.25, epsilon=0.05).fit(X, X[:, 0]).predict(X)
    np.testing.assert_allclose(model.predict(X), wanted, atol=1e-4)
