"""Learning on: more data for a fitted Γ or C, fewer rows of what there is, fewer centres.

When more data come, hyper-parameters, standardisation and C's probability curve stay; the solver
starts from the old coefficients, so the answer is the exact solution on all rows, old and new, and
only the way there is shorter.
"""

from copy import deepcopy
from typing import Any, TypeVar

import torch
from torch import Tensor

from cgtorch.domains.success import SuccessClassifier
from cgtorch.domains.transition import TransitionModel, rim
from cgtorch.domains.transition_fit import transition_rows
from cgtorch.svm import SVC, SVR, CompactReport, compact, inputs
from cgtorch.svm.coreset import reindex, support_coreset
from cgtorch.svm.svc import ClassWeight

G = TypeVar("G", bound=TransitionModel)
C = TypeVar("C", bound=SuccessClassifier)


def update_transition_model(
    model: G,
    percept: Any,
    control: Any,
    next_percept: Any,
    *,
    max_memory: int = inputs.MAX_MEMORY,
) -> G:
    """A new Γ fitted on more transitions; the old one stays as it is.

    Args:
        model: A fitted model, not a compact one.
        percept: All percepts (n, D), those of the last fit first and in the same order.
        control: Their controls (n, U).
        next_percept: Their next percepts (n, D).
        max_memory: Bytes that kernel matrices may take.

    Raises:
        DataError: Wrong shapes, NaN, or fewer rows than before.
        ModelError: Not fitted.
    """
    p, u, q = transition_rows(percept, control, next_percept, max_memory)
    kind = model.mean.dtype
    fresh = deepcopy(model).double().to(p.device)
    old = fresh.machine
    old._check_fitted()
    fresh.most = torch.maximum(fresh.most, fresh.extremes(p, u).amax(0))
    if not bool(old.cost.any()):  # it says nothing, see `fit_transition_model`
        return fresh.to(kind)
    target, tells = fresh.targets(p, u, q)
    features = fresh.features(p, u)[tells]
    machine = SVR(
        old.cost.tolist(),
        gamma=float(old.gamma_value),
        epsilon=old.tube.tolist(),
        max_memory=max_memory,
    )
    machine.load_state_dict(old.state_dict())
    fresh.machine = machine.fit(features, target[tells], warm=True)
    fresh.reach = rim(fresh.machine, features)
    return fresh.to(kind)


def update_success_classifier(
    model: C,
    percept: Any,
    label: Any,
    *,
    class_weight: ClassWeight = None,
    max_memory: int = inputs.MAX_MEMORY,
) -> C:
    """A new C fitted on more labels; the old one stays as it is.

    The curve from decision values to probabilities stays, too: it belongs to the hyper-parameters,
    and fitting it anew on held-out folds would cost five times the update itself.

    Args:
        model: A fitted classifier, not a compact one.
        percept: All percepts (n, D), those of the last fit first and in the same order.
        label: Their labels (n,).
        class_weight: As in the first fit.
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
        max_memory=max_memory,
    )
    machine.load_state_dict(old.state_dict())
    fresh.machine = machine.fit(features, signs, warm=True)
    fresh.machine.platt = old.platt
    return fresh.to(kind)


def transition_coreset(
    model: G, percept: Tensor, control: Tensor, next_percept: Tensor, limit: int
) -> tuple[Tensor, G]:
    """At most `limit` of the transitions (n, ...) that Γ was fitted on, and Γ to go on from there.

    Transitions that tell the machine nothing go first, as Γ never learnt from them.

    Returns:
        The indices (m,) that stay, ascending, and Γ in terms of these rows: the start of an
        update, which predicts as before only if no support vector had to go.
    """
    if len(percept) <= limit:
        return torch.arange(len(percept), device=percept.device), model
    exact = (x.double() for x in (percept, control, next_percept))
    _, tells = deepcopy(model).double().targets(*exact)
    telling = tells.nonzero().flatten()
    chosen = support_coreset(model.machine, model.features(percept, control)[telling], limit)
    smaller = deepcopy(model)
    reindex(smaller.machine, chosen)
    return telling[chosen], smaller


def label_coreset(model: C, percept: Tensor, limit: int) -> tuple[Tensor, C]:
    """At most `limit` of the labelled percepts (n, D) that C was fitted on, and C to go on from.

    Returns:
        As `transition_coreset`.
    """
    if len(percept) <= limit:
        return torch.arange(len(percept), device=percept.device), model
    chosen = support_coreset(model.machine, model.features(percept), limit)
    smaller = deepcopy(model)
    reindex(smaller.machine, chosen)
    return chosen, smaller


def compact_transition_model(
    model: G, centres: int, percept: Tensor, control: Tensor
) -> tuple[G, CompactReport]:
    """`cgtorch.svm.compact` for Γ on percepts (n, D) and controls (n, U).

    Few centres lie further apart, so what counts as novel is found again.
    """
    smaller, features = deepcopy(model), model.features(percept, control)
    smaller.machine, report = compact(model.machine, centres, features)
    smaller.reach = rim(smaller.machine, features)
    return smaller, report


def compact_success_classifier(model: C, centres: int, percept: Tensor) -> tuple[C, CompactReport]:
    """`cgtorch.svm.compact` for C on percepts (n, D); the loss is in decision values."""
    smaller = deepcopy(model)
    smaller.machine, report = compact(model.machine, centres, model.features(percept))
    return smaller, report
