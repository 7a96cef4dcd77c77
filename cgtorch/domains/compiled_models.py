"""The default Γ and C of any domain in the form of compiled rollouts."""

from typing import Any

import torch

from cgtorch.domains.success import SuccessClassifier
from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.ground.fields import KINDS, bounds_of, columns_of
from cgtorch.native import agree, alike, constants, structure
from cgtorch.simulation import CompiledModels, ModelEnvironment
from cgtorch.simulation.model import anything
from cgtorch.svm.rbf import LOG2E, machine_structure


def compiled_models(e: ModelEnvironment) -> CompiledModels | None:
    """Γ and C for compiled rollouts; None for subclasses, and for features that a user added."""
    gamma, classifier = getattr(e.gamma, "__self__", None), e.classifier
    if type(gamma) is not KernelTransitionModel or type(classifier) is not SuccessClassifier:
        return None
    if e.possible is not anything or e.gamma != gamma.predict_with_novelty:
        return None
    models = _structure(e, gamma, classifier)
    return models and CompiledModels("kernel", e.percepts.dtype, models)


def _structure(
    e: ModelEnvironment, gamma: KernelTransitionModel, classifier: SuccessClassifier
) -> Any:
    """A `KernelModels` of kernel_environment.h, or None if sizes or types do not fit."""
    fields = *gamma.percept_fields, *gamma.control_fields
    angles = [columns_of(f, "angle") for f in (gamma.percept_fields, classifier.percept_fields)]
    machines, platt = (gamma.machine, classifier.machine), classifier.machine.platt
    given = [x for m in machines for x in m.tensors] + [
        platt, gamma.mean, gamma.scale, gamma.most, gamma.shift, gamma.spread, gamma.learnt,
        classifier.mean, classifier.scale,
    ]  # fmt: skip
    sizes = len(gamma.percept_fields), len(gamma.control_fields)
    if (
        not all(machine.fitted for machine in machines)
        or gamma.further is not None
        or classifier.further is not None
        or angles[0] != angles[1]
        or sizes != (e.percept_size, e.control_size)
        or not alike(e.percepts, *given)
        or not bool(platt.isfinite().all())
    ):
        return None
    known = [machine_structure(*machine.tensors) for machine in machines]
    if None in known or (known[0].k, known[1].k) != (e.percept_size, 1):
        return None
    dtype = e.percepts.dtype
    agree(constants("field_kinds", dtype), {kind.upper(): i for i, kind in enumerate(KINDS)})
    low, high = (bound.to(e.percepts) for bound in bounds_of(fields))
    slope, offset = platt.tolist()
    return structure("KernelModels", dtype)(
        gamma=known[0], classifier=known[1],
        kind=torch.tensor([KINDS.index(field.kind) for field in fields]).to(e.percepts.device),
        low=low, high=high,
        mean=gamma.mean, scale=gamma.scale, most=gamma.most, seen_mean=classifier.mean,
        seen_scale=classifier.scale, shift=gamma.shift, change=gamma.spread * gamma.learnt,
        size=sizes[0], controls=sizes[1], reach=float(gamma.reach),
        per_distance=1 / (float(gamma.machine.gamma_value) * LOG2E), slope=slope, offset=offset,
    )  # fmt: skip
