"""What the robot knows: its experience, and the Γ and C it has learned from it."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.data import Dataset
from cgtorch.models import (
    SuccessClassifier,
    SuccessReport,
    TransitionModel,
    TransitionReport,
    fit_success_classifier,
    fit_transition_model,
    update_success_classifier,
    update_transition_model,
)
from cgtorch.simulation import ModelEnvironment
from cgtorch.world import motion_possible
from cgtorch.world.geometry import box_rectangle

LOOKS = 16  # motions for which errors of Γ are drawn; later ones use them again


@dataclass(frozen=True)
class Knowledge:
    """Experience and models, replaced as a whole when the robot learns.

    Attributes:
        dataset: all that Γ and C are trained on.
        gamma: the transition model.
        classifier: the success classifier.
        gamma_report: how well Γ does in cross-validation.
        classifier_report: how well C does in cross-validation.
    """

    dataset: Dataset
    gamma: TransitionModel
    classifier: SuccessClassifier
    gamma_report: TransitionReport
    classifier_report: SuccessReport


def fit_models(dataset: Dataset, seed: int) -> Knowledge:
    """Γ and C from data, hyper-parameters chosen by cross-validation."""
    gamma, gamma_report = fit_transition_model(
        dataset.percept, dataset.motion, dataset.next_percept, seed=seed
    )
    classifier, report = fit_success_classifier(dataset.grasp_percept, dataset.graspable, seed=seed)
    return Knowledge(dataset, gamma, classifier, gamma_report, report)


def imagine(
    knowledge: Knowledge,
    percepts: Tensor,
    footprint: Tensor,
    replicas: int,
    generator: Generator,
    device: torch.device | str = "cpu",
) -> ModelEnvironment:
    """The models as an environment, each scenario `replicas` times with other errors of Γ.

    Scenario i has the indices i · replicas … i · replicas + replicas - 1. The errors are drawn
    from those that Γ makes on its training data, so that a skill must not rely on being exact.

    Args:
        knowledge: the models.
        percepts: (B, D) first percepts.
        footprint: (4,) of the base (m).
        replicas: at least 1.
        generator: of the errors.
        device: where the environment runs.
    """
    with torch.no_grad():
        data = knowledge.dataset
        pick = torch.randperm(len(data.percept), generator=generator)[:1000]
        residual = data.next_percept[pick] - knowledge.gamma(data.percept[pick], data.motion[pick])
    rows = torch.randint(len(residual), (len(percepts) * replicas, LOOKS), generator=generator)
    return ModelEnvironment(
        percepts.repeat_interleave(replicas, 0).to(device),
        copy.deepcopy(knowledge.gamma).to(device),
        copy.deepcopy(knowledge.classifier).to(device),
        possible_with(footprint.to(device)),
        errors=residual[rows].to(device),
    )


def possible_with(footprint: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    """MoveBase's own check on percepts: the way must be clear of the box seen around the table."""

    def possible(percept: Tensor, motion: Tensor) -> Tensor:
        return motion_possible(motion, box_rectangle(percept[:, :4]), footprint)

    return possible


MOST_NEW = 400  # rows of one experience that are learned from


def learn(knowledge: Knowledge, experience: Dataset, generator: Generator) -> Knowledge:
    """Γ and C trained on more experience, from where they stand; hyper-parameters stay.

    At most `MOST_NEW` transitions and as many grasps are added. The reports stay those of the
    last cross-validation.
    """
    data = knowledge.dataset.extended(sampled(experience, MOST_NEW, generator))
    gamma = update_transition_model(
        knowledge.gamma, data.percept, data.motion, data.next_percept, seed=generator
    )
    classifier = update_success_classifier(
        knowledge.classifier, data.grasp_percept, data.graspable, seed=generator
    )
    return replace(knowledge, dataset=data, gamma=gamma, classifier=classifier)


def sampled(dataset: Dataset, most: int, generator: Generator) -> Dataset:
    """At most `most` transitions and `most` grasps, chosen at random."""
    moves = torch.randperm(len(dataset.percept), generator=generator)[:most]
    grasps = torch.randperm(len(dataset.graspable), generator=generator)[:most]
    return Dataset(
        dataset.percept[moves],
        dataset.motion[moves],
        dataset.next_percept[moves],
        dataset.grasp_percept[grasps],
        dataset.graspable[grasps],
    )
