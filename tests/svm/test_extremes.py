"""Outliers, tiny targets, far features and extreme costs: as optimal as libsvm is, or more so.

Optimality is computed apart, on a kernel matrix from the differences of features.
"""

import numpy as np
import pytest
import sklearn.svm
import torch
from dual_problems import dual_problems, ones, wrong

from cgtorch import native
from cgtorch.ground.errors import DataError
from cgtorch.svm import SVC, SVR
from cgtorch.svm.problems import (
    State,
    at_zero,
    dual_objective,
    middle_bias,
    relative_gap,
)
from cgtorch.svm.rbf import Gram, predict_rbf
from cgtorch.svm.smo import GAP, compiled_smo_steps, smo_steps
from cgtorch.svm.solver import continued, polish

RNG = np.random.default_rng(0)
X = RNG.standard_normal((60, 3))
FRESH = np.concatenate([X, X + 0.3 * RNG.standard_normal((60, 3))])
TARGET = np.sin(2 * X[:, 0]) + 0.1 * RNG.standard_normal(60)
LABEL = (X[:, 0] + 0.3 * RNG.standard_normal(60) > 0).astype(int)
FEW = np.arange(60) < 5


def with_column(first) -> np.ndarray:
    """The rows with another first feature."""
    return np.column_stack([first, X[:, 1:]])


def libsvm(ours: SVC | SVR, x, y, unit: float, **how):
    """The machine of scikit-learn with the same settings, to a millionth of the unit."""
    about = {"C": ours.C, "gamma": ours.gamma, "tol": 1e-6 * unit, "max_iter": 10**6}
    if isinstance(ours, SVR):
        return sklearn.svm.SVR(**about, epsilon=ours.epsilon).fit(x, y, **how)
    return sklearn.svm.SVC(**about).fit(x, y, **how)


def optimality(machine, ours: SVC | SVR, x, y) -> tuple[float, float]:
    """The violation and the dual objective, from the definition, of a machine fitted to x and y."""
    beta = torch.zeros(1, len(x), dtype=torch.float64)
    if machine is ours:
        beta[0, ours.support] = ours.weights[:, 0]
    else:
        beta[0, machine.support_.tolist()] = torch.tensor(machine.dual_coef_.ravel())
    z = torch.tensor(y, dtype=torch.float64)
    epsilon = ours.epsilon if isinstance(ours, SVR) else None
    problems = dual_problems(z, ours.C, epsilon)
    differences = torch.tensor(x)[:, None] - torch.tensor(x)
    kernel = torch.exp(-float(ours.gamma_value) * differences.square().sum(-1))
    found = State(beta, beta @ kernel, 0 * ones(1), 0 * ones(1))
    return float(wrong(problems, beta, kernel)), float(dual_objective(problems, found))


def values(machine, x) -> np.ndarray:
    """Decision values or predictions."""
    is_classifier = isinstance(machine, SVC | sklearn.svm.SVC)
    return machine.decision_function(x) if is_classifier else machine.predict(x)


def assert_equal(ours: SVC | SVR, x, y, unit: float = 1.0, fresh=FRESH, atol: float = 1e-3) -> None:
    """The machine is optimal, no worse than libsvm's, and has the same values."""
    theirs = libsvm(ours, x, y, unit)
    violation, objective = optimality(ours, ours, x, y)
    assert violation <= 3e-6 * unit
    assert objective <= optimality(theirs, ours, x, y)[1] + 1e-5 * unit**2 + 1e-14 * abs(objective)
    np.testing.assert_allclose(values(ours, fresh), values(theirs, fresh), rtol=0, atol=atol * unit)


@pytest.mark.parametrize("gamma", [1e-3, 0.5])
@pytest.mark.parametrize(
    "x", [with_column(np.where(FEW, 1e9, X[:, 0]))[4:], X * [1.0, 1e9, 1.0]], ids=["one", "all"]
)
def test_far_features_take_no_digits_from_the_others(x, gamma):
    n = len(x)
    assert_equal(SVC(gamma=gamma).fit(x, LABEL[-n:]), x, LABEL[-n:], fresh=x)
    assert_equal(SVR(gamma=gamma).fit(x, TARGET[-n:]), x, TARGET[-n:], fresh=x)


@pytest.mark.parametrize("kind", [SVC, SVR])
@pytest.mark.parametrize(
    "x",
    [
        with_column(np.where(FEW, 1e9, X[:, 0])),
        with_column(np.where(FEW, 1e9 + np.arange(60), X[:, 0])),
        with_column(np.where(np.arange(60) % 2, 1e9, 0) + X[:, 0]),
        X + 1e8,
    ],
    ids=["same", "near each other", "two clusters", "offset"],
)
def test_where_libsvm_loses_digits_of_distances_this_solution_is_nearer_to_the_optimum(kind, x):
    y = LABEL if kind is SVC else TARGET
    ours = kind(gamma=0.5).fit(x, y)
    violation, objective = optimality(ours, ours, x, y)
    assert violation <= 1e-6
    worse, other = optimality(libsvm(ours, x, y, 1.0), ours, x, y)
    assert worse > 0.1
    assert objective < other


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_predictions_without_a_compiler_have_the_digits_of_near_rows(kind):
    rows = torch.tensor(with_column(np.where(FEW, 1e9, X[:, 0]))).to(kind)
    machine = rows, rows[:, :2], rows.new_zeros(2), rows.new_tensor(0.5)
    squares = (rows[5:, None].double() - rows.double()).square().sum(-1)
    weights = torch.where(torch.tensor(FEW)[:, None], 0.0, rows[:, :2].double())
    truth = torch.exp(-0.5 * squares) @ weights
    found, nearest = predict_rbf(rows[5:], *machine)
    torch.testing.assert_close(found.double(), truth, atol=1e-5, rtol=0)
    assert float(nearest.max()) < 1e-5
    assert torch.equal(predict_rbf(rows[7:9], *machine)[0], found[2:4])
    with_gradients = predict_rbf(rows[5:].requires_grad_(), *machine)[0]
    torch.testing.assert_close(with_gradients.double(), truth, atol=1e-5, rtol=0)


@pytest.mark.parametrize("epsilon", [0.0, 0.1])
@pytest.mark.parametrize("cost", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(
    "y",
    [
        np.where(np.arange(60) < 1, -1e9, TARGET),
        np.where(np.arange(60) < 6, 1e9 * X[:, 1], TARGET),
        np.where(np.arange(60) < 25, 1e9, TARGET),
        np.where(np.arange(60) < 40, 0.0, np.where(np.arange(60) < 50, TARGET, 1e9)),
    ],
    ids=["one", "six", "many", "among zeros"],
)
def test_outliers_among_the_targets_take_no_digits_from_the_others(y, cost, epsilon):
    unit = min(cost, 1.0)
    assert_equal(SVR(cost, epsilon=epsilon, gamma=0.4).fit(X, y), X, y, unit)


@pytest.mark.parametrize("cost", [1e-3, 1.0, 1e3])
def test_an_outlier_among_equal_targets_is_worth_its_cost(cost):
    y = np.where(np.arange(60) == 3, 1e9, 0.0)
    assert_equal(SVR(cost, epsilon=0.0, gamma=0.4).fit(X, y), X, y, cost)


@pytest.mark.parametrize("offset", [0.0, 1.0])
@pytest.mark.parametrize(("cost", "epsilon"), [(1.0, 0.0), (1e6, 0.0), (1e6, 1e-10)])
@pytest.mark.parametrize("y", [TARGET, np.where(np.arange(60) == 3, 1.0, 0.0)], ids=["all", "one"])
def test_tiny_targets_have_as_many_digits_as_others(y, cost, epsilon, offset):
    """libsvm is asked in another unit, as its smallest coefficients are absolute."""
    ours = SVR(cost, epsilon=epsilon, gamma=0.4).fit(X, y * 1e-9 + offset)
    oracle = sklearn.svm.SVR(C=1e6, epsilon=epsilon * 1e9, gamma=0.4, tol=1e-7).fit(X, y)
    found = (ours.predict(FRESH) - offset) * 1e9
    np.testing.assert_allclose(found, oracle.predict(FRESH), rtol=0, atol=1e-3)


@pytest.mark.parametrize("cost", [1e-9, 1e-6])
def test_tiny_costs_have_as_many_digits_as_others(cost):
    assert_equal(SVC(cost, gamma=0.4).fit(X, LABEL), X, LABEL, cost)
    assert_equal(SVR(cost, gamma=0.4).fit(X, TARGET), X, TARGET, cost)


@pytest.mark.filterwarnings("ignore:Solver terminated early")
@pytest.mark.parametrize("epsilon", [None, 0.0, 0.1])
def test_what_libsvm_does_not_end_is_solved_by_continuation(epsilon):
    """A smooth kernel with a large cost: minimal optimisation goes on for millions of steps."""
    x, y = X[:, :1], LABEL if epsilon is None else TARGET
    machine = SVC(1e6, gamma=1.0) if epsilon is None else SVR(1e6, gamma=1.0, epsilon=epsilon)
    violation, objective = optimality(machine.fit(x, y), machine, x, y)
    assert violation <= 2e-6
    theirs = sklearn.svm.SVC(C=1e6, gamma=1.0, tol=1e-6, max_iter=10**5)
    if epsilon is not None:
        theirs = sklearn.svm.SVR(C=1e6, gamma=1.0, tol=1e-6, max_iter=10**5, epsilon=epsilon)
    worse, other = optimality(theirs.fit(x, y), machine, x, y)
    assert worse > 0.01
    assert objective < other


def test_a_continuation_goes_where_exact_steps_do_not():
    x, _, noise = np.random.default_rng(0).standard_normal((3, 150))
    problems = dual_problems(torch.tensor(x + 0.3 * noise), 1e6)
    kernel = Gram(torch.tensor(x[:, None]), 0.3).matrix
    rough = smo_steps(kernel, problems, at_zero(problems), 1e-2 * ones(1), 300)
    about = kernel, problems.take(0), rough.take(0), 1e-6
    assert polish(*about) is None
    found = continued(*about)
    assert float(found.violation) <= 1e-6
    assert float(wrong(problems, found.beta[None], kernel)) <= 1e-5


def test_an_outlier_hides_no_gap():
    """Its share of the objective, which nothing can change, would hide that of all others."""
    z = torch.tensor([1e9, 0.5, -0.5, 0.0], dtype=torch.float64)
    problems, kernel = dual_problems(z, 1.0, 0.0), torch.eye(4, dtype=torch.float64)
    beta = torch.tensor([[1.0, -0.3, -0.4, -0.3]], dtype=torch.float64)
    poor = State(beta, beta @ kernel, 0 * ones(1), ones(1))
    assert float(relative_gap(problems, poor)) > 0.01


@pytest.mark.skipif(not native.available(), reason="there is no C compiler")
def test_compiled_steps_see_the_gap_beside_an_outlier():
    z = torch.tensor(np.where(np.arange(60) == 3, 1e9, TARGET))
    problems, gram = dual_problems(z, 1.0, 0.0), Gram(torch.tensor(X), 0.4)
    found = compiled_smo_steps(gram.double, problems, at_zero(problems), 2 * ones(1), 1e9, 1)
    assert float(relative_gap(problems, found)) <= GAP


def test_a_bound_far_beyond_all_coefficients_leaves_the_bias_that_free_ones_determine():
    z = torch.tensor([3.0, -3.0, 0.0], dtype=torch.float64)
    problems = dual_problems(z, 1e15, 0.5)
    beta = torch.tensor([[2.0, -2.0, 0.0]], dtype=torch.float64)
    found = State(beta, 0.5 * beta, 0.125 * ones(1), ones(1))
    assert float(middle_bias(problems, found)) == 0.125


def weighted(name: str) -> np.ndarray:
    """Weights of the rows."""
    uniform = np.random.default_rng(1).uniform(0, 2, 60)
    return {
        "uniform": uniform,
        "some zero": np.where(uniform < 0.7, 0.0, uniform),
        "wide": 10 ** (4 * uniform - 4),
        "outlier": np.where(FEW, 1e9, 1.0),
        "tiny": 1e-9 * uniform,
    }[name]


@pytest.mark.parametrize("name", ["uniform", "some zero", "wide", "outlier", "tiny"])
def test_weights_of_rows_are_those_of_libsvm(name):
    weight, unit = weighted(name), 1e-9 if name == "tiny" else 1.0
    for machine, y in ((SVC(5.0, gamma=0.3), LABEL), (SVR(5.0, gamma=0.3), TARGET)):
        machine.fit(X, y, sample_weight=weight)
        theirs = libsvm(machine, X, y, unit * 1e-3, sample_weight=weight)
        found, wanted = values(machine, FRESH), values(theirs, FRESH)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4 * unit)
        assert not (weight[machine.support] == 0).any()
        again = machine.learn_on(X, y, sample_weight=weight)
        np.testing.assert_allclose(values(again, FRESH), found, rtol=0, atol=1e-4 * unit)


def test_a_weight_is_a_number_of_copies_with_and_without_a_compiler(monkeypatch):
    times = np.arange(60) % 3
    many = np.repeat(np.arange(60), times)
    copied = SVR(2.0, gamma=0.3).fit(X[many], TARGET[many]).predict(FRESH)
    found = SVR(2.0, gamma=0.3).fit(X, TARGET, sample_weight=times)
    np.testing.assert_allclose(found.predict(FRESH), copied, atol=1e-5)
    monkeypatch.setattr("cgtorch.svm.smo.function", lambda *_: None)
    plain = SVR(2.0, gamma=0.3).fit(X, TARGET, sample_weight=times)
    np.testing.assert_allclose(plain.predict(FRESH), copied, atol=1e-5)


@pytest.mark.parametrize(
    ("weight", "says"),
    [
        (np.ones(59), "one weight per row"),
        (-np.ones(60), "reaches from -1 to -1"),
        (np.zeros(60), "at least one must be positive"),
        (np.full(60, np.nan), "sample_weight has 60 NaN"),
        (np.where(LABEL, 0.0, 1.0), "one class only"),
    ],
)
def test_weights_that_leave_nothing_to_learn_are_one_clear_error(weight, says):
    with pytest.raises(DataError, match=says):
        SVC().fit(X, LABEL, sample_weight=weight)
