"""Learning on: more data for a fitted Γ or C, from where the last fit ended.

Hyper-parameters and standardisation stay; the active set starts from the old coefficients, so the
answer is the exact solution on all rows, old and new, and only the way there is shorter.
"""

from copy import deepcopy
from typing import Any

import torch
from torch import Tensor

from cgtorch.errors import DataError
from cgtorch.models import geometry, inputs
from cgtorch.models.folds import stratified_folds
from cgtorch.models.success import SuccessClassifier
from cgtorch.models.svc import SVC, ClassWeight
from cgtorch.models.svr import SVR
from cgtorch.models.transition import TransitionModel, rim


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
    p, u = inputs.as_rows(percept, "percept"), inputs.as_rows(motion, "motion")
    q = inputs.as_rows(next_percept, "next_percept")
    geometry.check_percept(p, u)
    if not len(p) == len(u) == len(q) or q.shape[1] != 7:
        raise DataError(f"percept, motion and next percept have {len(p)}, {len(u)}, {len(q)} rows")
    kind = model.mean.dtype
    fresh = deepcopy(model).double().to(p.device)
    old = fresh.machine
    old._check_fitted()
    parts = geometry.to_parts(p)
    residual = geometry.to_parts(q) - geometry.move_rigidly(parts, u)
    features, target = fresh.features(p, u), residual / fresh.residual_scale
    learnt = (old.cost > 0).nonzero().flatten()
    if len(learnt) == 0:
        return fresh.to(kind)
    part = SVR(
        old.cost[learnt].tolist(),
        gamma=float(old.gamma_value),
        epsilon=old.tube[learnt].tolist(),
        seed=seed,
        max_memory=max_memory,
    )
    part.centres, part.support, part.gamma_value = old.centres, old.support, old.gamma_value
    part.weights, part.bias = old.weights[:, learnt], old.bias[learnt]
    part.fit(features, target[:, learnt], warm=True)
    beta = torch.zeros_like(target.T)
    bias, gap = torch.zeros_like(old.bias), torch.zeros_like(old.bias)
    beta[learnt[:, None], part.support] = part.weights.T
    bias[learnt], gap[learnt] = part.bias, part.gap
    old._keep(features, beta, bias, gap, float(old.gamma_value))
    fresh.reach = rim(old, features)
    return fresh.to(kind)


def update_success_classifier(
    model: SuccessClassifier,
    percept: Any,
    label: Any,
    *,
    folds: int = 5,
    class_weight: ClassWeight = None,
    seed: int | torch.Generator = 0,
    max_memory: int = inputs.MAX_MEMORY,
) -> SuccessClassifier:
    """A new C fitted on more labels, its probabilities too; the old one stays as it is.

    Args:
        model: A fitted classifier, not a compact one.
        percept: All percepts (n, D), those of the last fit first and in the same order.
        label: Their labels (n,).
        folds: Number of stratified folds for the probabilities.
        class_weight: As in the first fit.
        seed: Seed or generator of folds and solver.
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
    generator = inputs.generator_of(seed)
    machine = SVC(
        float(old.cost),
        gamma=float(old.gamma_value),
        class_weight=class_weight,
        probability=True,
        folds=stratified_folds(signs, folds, generator),
        seed=generator,
        max_memory=max_memory,
    )
    machine.load_state_dict(old.state_dict())
    fresh.machine = machine.fit(features, signs, warm=True)
    return fresh.to(kind)
