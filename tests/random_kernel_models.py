"""The default Γ and C of domains with random numbers in them, in float64."""

from collections.abc import Sequence

import torch
from support import as_double_actions, random_skill, seeded
from torch import Generator

from cgtorch.domains.compiled_models import compiled_models
from cgtorch.domains.success import SuccessClassifier
from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.graphs import ActionSet, BranchingNN, ContinuousNN, Perceive, Step, SubSkill, Test
from cgtorch.ground.fields import Field
from cgtorch.simulation import ModelEnvironment

CENTRES = 40
PLAIN = (Field("x", low=-3.0), Field("y", high=4.0))
MIXED = (
    Field("x", "m", -2.0, 2.0), Field("turn", "rad", kind="angle"), Field("gear", kind="discrete"),
    Field("arm", "rad", -1.0, 5.0, kind="angle"), Field("count", "", 0.0, 3.0, kind="discrete"),
)  # fmt: skip
PUSH = (Field("push", "N", -1.0, 1.0),)
STEER = (Field("push", "N", -1.0, 1.0), Field("steer", "rad", -0.5, 3.0, kind="angle"))
DOMAINS = {"plain": (PLAIN, PUSH), "mixed": (MIXED, STEER)}


def random_machine(machine: torch.nn.Module, features: int, outputs: int, g: Generator) -> None:
    machine.centres = torch.randn(CENTRES, features, generator=g).double()
    machine.weights = torch.randn(CENTRES, outputs, generator=g).double() / 2
    machine.bias = torch.randn(outputs, generator=g).double() / 4
    machine.support, machine.gamma_value = torch.arange(CENTRES), torch.tensor(0.2).double()


def random_kernel_models(
    seed: int, count: int, percept: Sequence[Field], control: Sequence[Field], errors: bool = True
) -> ModelEnvironment:
    """Random machines and first percepts, in float64."""
    g, d = seeded(seed), len(percept)
    gamma, classifier = KernelTransitionModel(percept, control), SuccessClassifier(percept)
    percepts = torch.randn(count, d, generator=g).double()
    for i, field in enumerate(percept):
        if field.kind == "discrete":
            percepts[:, i] = percepts[:, i].abs().round()
    raw = gamma.raw_features(percepts, percepts[:, : len(control)])
    seen = classifier.raw_features(percepts)
    gamma.mean, gamma.scale = raw.mean(0), raw.std(0) + 0.2
    gamma.most = torch.full_like(gamma.mean, 2.0)
    gamma.reach = torch.tensor(4.0).double()
    gamma.shift, gamma.spread = (torch.rand(d, generator=g).double() / 2 for _ in range(2))
    gamma.learnt = (torch.rand(d, generator=g) > 0.2).double()
    classifier.mean, classifier.scale = seen.mean(0), seen.std(0) + 0.2
    random_machine(gamma.machine, raw.shape[1], d, g)
    random_machine(classifier.machine, seen.shape[1], 1, g)
    value = classifier.decision_function(percepts)
    classifier.machine.bias -= value.quantile(0.8)
    classifier.machine.platt = torch.tensor([-2.0, 0.1]).double()
    noise = 0.02 * torch.randn(count, 3, d, generator=g).double()
    return ModelEnvironment(
        percepts, gamma.predict_with_novelty, classifier, control_size=len(control),
        errors=noise if errors else None, most_novel=0.8, compiled=compiled_models,
    )  # fmt: skip


def actions_for(environment: ModelEnvironment, hidden: int, nested: bool) -> ActionSet:
    d, u = environment.percept_size, environment.control_size
    actions = ActionSet(
        ("Aim", "Step", "Look", "Branch", "Test"),
        (ContinuousNN(d, hidden, u), Step(u), Perceive(), BranchingNN(d, hidden), Test()),
    )
    if nested:
        inner = random_skill(3, "inner", actions, max_transitions=5)
        actions = actions.extended(["inner"], [SubSkill(inner)])
    return as_double_actions(actions)
