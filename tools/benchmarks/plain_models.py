"""Γ and C in the hands of somebody without this library: numbers, and machines of scikit-learn."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.workload import Workload
from cgtorch.svm.machine import KernelMachine
from cgtorch.tabletop.domain import MARGIN
from cgtorch.tabletop.models import GraspClassifier, TableTransitionModel
from cgtorch.tabletop.world.clear_motion import CLEARANCE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Machine:
    """An RBF machine of one output: what scikit-learn calls support vectors and coefficients.

    Attributes:
        centres: (m, d).
        weights: (m,).
        bias: of the output.
        gamma: of the kernel.
        mean: (d,) subtracted from features, which are then
        scale: (d,) divided by this.
    """

    centres: Array
    weights: Array
    bias: float
    gamma: float
    mean: Array
    scale: Array


@dataclass(frozen=True)
class PlainModels:
    """All numbers of a `Workload`'s environment, as float64; arrays only, so any process reads it.

    Attributes:
        percepts: (B, 7) first percepts.
        errors: (B, T, 7) added to Γ's prediction at each motion.
        most_novel: where a motion is more novel, the lane is lost.
        transition: the machine of Γ.
        sides: (2,), `trust`, `reach` and `most` (4,) as in `TableTransitionModel`.
        success: the machine of C.
        platt: slope and offset of C's probability.
        body: (4, 2) corners of the footprint with all the room it must have (m).
    """

    percepts: Array
    errors: Array
    most_novel: float
    transition: Machine
    sides: Array
    trust: float
    reach: float
    most: Array
    success: Machine
    platt: tuple[float, float]
    body: Array


def plain_models(work: Workload) -> PlainModels:
    """The numbers of the models that the workload's environment holds."""
    environment = work.environment
    gamma, classifier = getattr(environment.gamma, "__self__", None), environment.classifier
    if not isinstance(gamma, TableTransitionModel) or not isinstance(classifier, GraspClassifier):
        raise TypeError(f"{environment.gamma} and {classifier} are not Γ and C of the tabletop")
    if environment.errors is None:
        raise TypeError("the environment has no errors of Γ")
    x0, x1, y0, y1 = work.footprint.double().tolist()
    room = MARGIN + CLEARANCE
    x0, x1, y0, y1 = x0 - room, x1 + room, y0 - room, y1 + room
    slope, offset = classifier.machine.platt.tolist()
    return PlainModels(
        percepts=_array(environment.percepts),
        errors=_array(environment.errors),
        most_novel=environment.most_novel,
        transition=_machine(gamma.machine, gamma.mean, gamma.scale),
        sides=_array(gamma.sides),
        trust=float(gamma.trust),
        reach=float(gamma.reach),
        most=_array(gamma.most),
        success=_machine(classifier.machine, classifier.mean, classifier.scale),
        platt=(slope, offset),
        body=np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]),
    )


def _machine(machine: KernelMachine, mean: Tensor, scale: Tensor) -> Machine:
    return Machine(
        _array(machine.centres),
        _array(machine.weights[:, 0]),
        float(machine.bias[0]),
        float(machine.gamma_value),
        _array(mean),
        _array(scale),
    )


def _array(x: Tensor) -> Array:
    return np.ascontiguousarray(x.detach().to(torch.float64).numpy())


def sklearn_svr(machine: Machine) -> Any:
    """`sklearn.svm.SVR` with these support vectors."""
    from sklearn import svm

    return _filled(svm.SVR(gamma=machine.gamma), machine, 1.0)


def sklearn_svc(machine: Machine) -> Any:
    """`sklearn.svm.SVC` with these support vectors; positive decisions mean success."""
    from sklearn import svm

    # libsvm's own sign of a classifier of two classes is the other one.
    return _filled(svm.SVC(gamma=machine.gamma), machine, -1.0)


def _filled(model: Any, machine: Machine, sign: float) -> Any:
    """A fitted object whose support vectors, coefficients and bias are replaced by others."""
    m = len(machine.centres)
    model.fit(machine.centres[:2], [0, 1])
    model.support_ = np.arange(m, dtype=np.int32)
    model.support_vectors_ = machine.centres
    model._n_support = np.array([m, 0], dtype=np.int32)
    model._dual_coef_ = sign * machine.weights[None]
    model._intercept_ = np.array([sign * machine.bias])
    model.dual_coef_, model.intercept_ = machine.weights[None], np.array([machine.bias])
    return model
