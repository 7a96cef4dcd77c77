"""Rollouts in the default Γ and C of any domain, compiled, against the engine in torch."""

import copy
from collections.abc import Sequence

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import Wander, as_double, as_double_actions, random_graphs, random_skill, seeded
from torch import Generator, Tensor

from cgtorch.actions import ActionSet, BranchingNN, ContinuousNN, Detect, Grasp, MoveBase
from cgtorch.domains.compiled_models import compiled_models
from cgtorch.domains.success import SuccessClassifier
from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.environment.fields import Field
from cgtorch.graphs import SubSkill
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts, rollout
from cgtorch.simulation.compiled import compiled_engine
from cgtorch.simulation.program import compile_graphs
from cgtorch.simulation.rollout import MAX_STEPS, rollout_in_torch

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

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


def models(
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
        (ContinuousNN(d, hidden, u), MoveBase(u), Detect(), BranchingNN(d, hidden), Grasp()),
    )
    if nested:
        inner = random_skill(3, "inner", actions, max_transitions=5)
        actions = actions.extended(["inner"], [SubSkill(inner)])
    return as_double_actions(actions)


def in_torch(
    seed: int, actions: ActionSet, environment: ModelEnvironment, some: Tensor
) -> tuple[Rollouts, Rollouts]:
    """What `rollout` says of random graphs, and what the engine in torch does."""
    graphs = as_double(random_graphs(seed, 20, actions))
    program = compile_graphs(graphs, actions)
    wanted = rollout_in_torch(program, environment, some, 20, MAX_STEPS)
    return rollout(graphs, actions, environment, scenarios=some), wanted


def assert_same(found: Rollouts, wanted: Rollouts) -> None:
    for name in ("succeeded", "timed_out", "transitions"):
        assert torch.equal(getattr(found, name), getattr(wanted, name)), name
    for name in ("percept", "state"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), atol=1e-8, rtol=0)


@given(
    seed=st.integers(0, 2**31),
    domain=st.sampled_from(list(DOMAINS)),
    hidden=st.integers(1, 5),
    nested=st.booleans(),
    errors=st.booleans(),
)
@settings(max_examples=60)
def test_compiled_rollouts_are_those_of_the_engine_in_torch(
    seed: int, domain: str, hidden: int, nested: bool, errors: bool
) -> None:
    environment = models(seed, 19, *DOMAINS[domain], errors)
    actions = actions_for(environment, hidden, nested)
    assert compiled_engine(actions, environment) is not None
    assert_same(*in_torch(seed, actions, environment, torch.arange(18, -1, -1)))


@pytest.mark.parametrize("domain", DOMAINS)
def test_the_comparison_meets_every_end(domain: str) -> None:
    environment = models(1, 30, *DOMAINS[domain])
    found = in_torch(1, actions_for(environment, 3, False), environment, torch.arange(30))[0]
    lost, moved = found.state[..., 1] > 0, found.state[..., 0] > 1
    ends = [int(x.sum()) for x in (found.succeeded, found.timed_out, lost, moved)]
    assert min(ends) >= 5, ends


@pytest.mark.parametrize("domain", DOMAINS)
def test_own_actions_run_among_compiled_models(domain: str) -> None:
    environment = models(2, 12, *DOMAINS[domain])
    actions = actions_for(environment, 2, True).extended(["Wander"], [Wander()])
    own = as_double_actions(actions)
    assert_same(*in_torch(2, own, environment, torch.arange(12)))


def test_what_is_not_the_default_has_no_counterpart() -> None:
    environment = models(0, 5, *DOMAINS["mixed"])
    gamma = environment.gamma.__self__  # type: ignore[attr-defined]

    class Mine(KernelTransitionModel):
        """A Γ that might do anything."""

    def known(**changed: object) -> bool:
        other = copy.copy(environment)
        vars(other).update(changed)
        return compiled_models(other) is not None

    def altered(model: torch.nn.Module, name: str, value: object) -> torch.nn.Module:
        other = copy.deepcopy(model)
        setattr(other, name, value)
        return other

    def predicts(model: torch.nn.Module) -> object:
        return model.predict_with_novelty

    mine = copy.deepcopy(gamma)
    mine.__class__ = Mine
    classifier = environment.classifier
    assert isinstance(classifier, torch.nn.Module)
    assert known()
    assert not known(gamma=predicts(mine))
    assert not known(gamma=lambda p, u: gamma.predict_with_novelty(p, u))
    assert not known(classifier=lambda p: classifier(p))
    assert not known(possible=lambda p, u: torch.ones(len(p), dtype=torch.bool))
    assert not known(gamma=predicts(altered(gamma, "further", lambda p, u: p)))
    assert not known(classifier=altered(classifier, "further", lambda p: p))
    assert not known(percepts=environment.percepts.float())
    assert not known(control_size=1)
