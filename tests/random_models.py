"""Γ and C with random numbers in them, in float64, as real ones have them by fitting."""

import copy

import torch
from support import FOOTPRINT, graspable, seeded
from torch import Tensor

from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.models import GraspClassifier, TableTransitionModel, compiled_models
from cgtorch.tabletop.models.success import grasp_features
from cgtorch.tabletop.world import (
    ClearMotion,
    TabletopWorld,
    cluttered_scenarios,
    general_scenarios,
    random_scenarios,
)
from cgtorch.tabletop.world.percepts import PERCEPTS

CENTRES = 50


def first_percepts(seed: int, count: int, percept: str, obstacles: int) -> Tensor:
    """(count, D) of the world, of tables of one size or of any, with so many obstacles at most."""
    generator = seeded(seed)
    if obstacles:
        scenarios = cluttered_scenarios(count, generator)
    elif percept == "yaw":
        scenarios = general_scenarios(count, generator)
    else:
        scenarios = random_scenarios("perimeter", count, generator)
    world = TabletopWorld(scenarios, graspable, FOOTPRINT, percept=percept)
    found = world.start(torch.arange(count))[1].double()
    return found[:, : PERCEPTS[percept] + 4 * obstacles]


def random_gamma(seed: int) -> TableTransitionModel:
    generator, gamma = seeded(seed), TableTransitionModel()
    gamma.sides = torch.tensor([0.7, 1.4], dtype=torch.float64)
    gamma.most = torch.tensor([3.0, 2.5, 3.2, 0.2], dtype=torch.float64)
    gamma.mean = torch.rand(4, generator=generator).double()
    gamma.scale = 0.2 + torch.rand(4, generator=generator).double()
    gamma.trust = torch.rand((), generator=generator).round().double()
    gamma.reach = torch.tensor(0.8, dtype=torch.float64)
    _fill(gamma.machine, torch.randn(CENTRES, 4, generator=generator).double(), generator)
    return gamma


def random_classifier(seed: int, percepts: Tensor) -> GraspClassifier:
    """One whose features are those of the percepts, without the height for an odd seed."""
    generator, model = seeded(seed), GraspClassifier()
    features = grasp_features(percepts)
    if features.shape[1] == 8:
        features = features[:, : 8 - seed % 2]
    model.mean, model.scale = features.mean(0), features.std(0) + 0.1
    centres = torch.randn(CENTRES, features.shape[1], generator=generator).double()
    _fill(model.machine, centres, generator)
    value = model.decision_function(percepts)
    model.machine.bias -= value.quantile(0.75)  # a quarter can be grasped from where it starts
    model.machine.platt = torch.tensor([-1.5, 0.1], dtype=torch.float64)
    return model


def _fill(machine: torch.nn.Module, centres: Tensor, generator: torch.Generator) -> None:
    machine.centres, machine.support = centres, torch.arange(CENTRES)
    machine.weights = torch.randn(CENTRES, 1, generator=generator).double()
    machine.bias = torch.randn(1, generator=generator).double() / 4
    machine.gamma_value = torch.tensor(0.3, dtype=torch.float64)


def random_models(
    seed: int, count: int, percept: str = "box", obstacles: int = 0, errors: bool = True
) -> ModelEnvironment:
    """Γ, C and the check of motions on first percepts of the world, in float64."""
    percepts = first_percepts(seed, count, percept, obstacles)
    noise = 0.02 * torch.randn(count, 3, percepts.shape[1], generator=seeded(seed)).double()
    if obstacles:
        noise[..., PERCEPTS[percept] :] *= percepts[:, None, PERCEPTS[percept] :] != 0
    return ModelEnvironment(
        percepts,
        random_gamma(seed).predict_with_novelty,
        random_classifier(seed, percepts),
        ClearMotion(torch.tensor(FOOTPRINT, dtype=torch.float64)),
        errors=noise if errors else None,
        most_novel=0.9,
        compiled=compiled_models,
    )


def models_as(
    environment: ModelEnvironment,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> ModelEnvironment:
    """The same models with other numbers or elsewhere."""
    gamma, classifier = (
        copy.deepcopy(model).to(device, dtype)
        for model in (environment.gamma.__self__, environment.classifier)  # type: ignore[attr-defined]
    )
    errors = environment.errors
    on_cpu = copy.deepcopy(environment.classifier).to(dtype)  # type: ignore[attr-defined]
    return ModelEnvironment(
        environment.percepts.to(device, dtype),
        gamma.predict_with_novelty,
        classifier,
        ClearMotion(environment.possible.footprint.to(device, dtype)),  # type: ignore[attr-defined]
        errors=None if errors is None else errors.to(device, dtype),
        most_novel=environment.most_novel,
        compiled=environment.compiled,
        chance=on_cpu(environment.percepts.to(dtype)).to(device),
    )
