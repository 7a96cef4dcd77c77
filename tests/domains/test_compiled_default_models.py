"""Rollouts in the default Γ and C of any domain, compiled, against the engine in torch."""

import copy

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_kernel_models import DOMAINS, actions_for, random_kernel_models
from support import Wander, as_double, as_double_actions, random_graphs
from torch import Tensor

from cgtorch.domains.compiled_models import compiled_models
from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.graphs import ActionSet
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts, rollout
from cgtorch.simulation.program import compile_graphs
from cgtorch.simulation.rollout import MAX_STEPS, engine_of
from cgtorch.simulation.torch_engine import rollout_in_torch

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")


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
@settings(max_examples=20)
def test_compiled_rollouts_are_those_of_the_engine_in_torch(
    seed: int, domain: str, hidden: int, nested: bool, errors: bool
) -> None:
    environment = random_kernel_models(seed, 19, *DOMAINS[domain], errors)
    actions = actions_for(environment, hidden, nested)
    assert engine_of(actions, environment) is not None
    assert_same(*in_torch(seed, actions, environment, torch.arange(18, -1, -1)))


@pytest.mark.parametrize("domain", DOMAINS)
def test_the_comparison_meets_every_end(domain: str) -> None:
    environment = random_kernel_models(1, 30, *DOMAINS[domain])
    found = in_torch(1, actions_for(environment, 3, False), environment, torch.arange(30))[0]
    lost, moved = found.state[..., 1] > 0, found.state[..., 0] > 1
    ends = [int(x.sum()) for x in (found.succeeded, found.timed_out, lost, moved)]
    assert min(ends) >= 5, ends


@pytest.mark.parametrize("domain", DOMAINS)
def test_own_actions_run_among_compiled_models(domain: str) -> None:
    environment = random_kernel_models(2, 12, *DOMAINS[domain])
    actions = actions_for(environment, 2, True).extended(["Wander"], [Wander()])
    own = as_double_actions(actions)
    assert_same(*in_torch(2, own, environment, torch.arange(12)))


def test_what_is_not_the_default_has_no_counterpart() -> None:
    environment = random_kernel_models(0, 5, *DOMAINS["mixed"])
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
