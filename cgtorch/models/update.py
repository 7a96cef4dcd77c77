"""Learning on: more data for a fitted Γ or C, from where the last fit ended.

Hyper-parameters, standardisation and C's probability curve stay; the active set starts from the
old coefficients, so the answer is the exact solution on all rows, old and new, and only the way
there is shorter.
"""

from copy import deepcopy
from typing import Any

import torch
from torch import Tensor

from cgtorch.models import inputs
from cgtorch.models.success import SuccessClassifier
from cgtorch.models.svc import SVC, ClassWeight
from cgtorch.models.svr import SVR
from cgtorch.models.transition import TransitionModel
from cgtorch.models.transition_fit import rim, transition_rows, which_yaw


def update_transition_model(
    model: TransitionModel,
    percept: Any,
    motion: Any,
    next_percept: Any,
    *,
    seed: int | torch.Generator = 0,
    max_memory: int = inputs.MAX_MEMORY,
) -> TransitionModel:
    """A new Γ fitted on more transitions; the old one stays as it is.

    Args:
        model: A fitted model, not a compact one.
        percept: All percepts (n, 7), those of the last fit first and in the same order.
        motion: Their motions (n, 3).
        next_percept: Their next percepts (n, 7).
        seed: Seed or generator of the solver.
        max_memory: Bytes that kernel matrices may take.

    Raises:
        DataError: Wrong shapes, NaN, or fewer rows than before.
        ModelError: Not fitted.
    """
    p, u, q = transition_rows(percept, motion, next_percept, max_memory)
    kind = model.mean.dtype
    fresh = deepcopy(model).double().to(p.device)
    old = fresh.machine
    old._check_fitted()
    fresh.most = torch.maximum(fresh.most, fresh.extremes(p, u).amax(0))
    if float(old.cost) == 0:
        return fresh.to(kind)
    target, tells = which_yaw(fresh, p, u, q)
    features = fresh.features(p)[tells]
    machine = SVR(
        float(old.cost),
        gamma=float(old.gamma_value),
        epsilon=float(old.tube),
        seed=seed,
        max_memory=max_memory,
    )
    machine.load_state_dict(old.state_dict())
    fresh.machine = machine.fit(features, target[tells][:, None], warm=True)
    fresh.reach = rim(fresh.machine, features)
    return fresh.to(kind)


def update_success_classifier(
    model: SuccessClassifier,
    percept: Any,
    label: Any,
    *,
    class_weight: ClassWeight = None,
    seed: int | torch.Generator = 0,
    max_memory: int = inputs.MAX_MEMORY,
) -> SuccessClassifier:
    """A new C fitted on more labels; the old one stays as it is.

    The curve from decision values to probabilities stays, too: it belongs to the hyper-parameters,
    and fitting it anew on held-out folds would cost five times the update itself.

    Args:
        model: A fitted classifier, not a compact one.
        percept: All percepts (n, D), those of the last fit first and in the same order.
        label: Their labels (n,).
        class_weight: As in the first fit.
        seed: Seed or generator of the solver.
        max_memory: Bytes that kernel matrices may take.

    Raises:
        DataError: Wrong shapes, NaN, one class only, or fewer rows than before.
        ModelError: Not fitted.
    """
    rows = inputs.as_rows(percept, "percept")
    _, signs = inputs.as_binary(label, len(rows))
    kind = model.mean.dtype
    fresh = deepcopy(model).double().to(rows.device)
    features: Tensor = fresh.features(rows)
    old = fresh.machine
    machine = SVC(
        float(old.cost),
        gamma=float(old.gamma_value),
        class_weight=class_weight,
        seed=seed,
        max_memory=max_memory,
    )
    machine.load_state_dict(old.state_dict())
    fresh.machine = machine.fit(features, signs, warm=True)
    fresh.machine.platt = old.platt
    return fresh.to(kind)
