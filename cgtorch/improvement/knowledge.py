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
    compact_transition_model,
    fit_success_classifier,
    fit_transition_model,
    update_success_classifier,
    update_transition_model,
)
from cgtorch.simulation import ModelEnvironment
from cgtorch.world import motion_possible
from cgtorch.world.geometry import box_rectangle

SWIFT_CENTRES = 256
LOOKS = 16  # motions for which errors of Γ are drawn; later ones use them again


@dataclass(frozen=True)
class Knowledge:
    """Experience and models, replaced as a whole when the robot learns.

    Attributes:
        dataset: all that Γ and C are trained on.
        gamma: the transition model.
        swift: the same with few centres, several times faster; what is found in it is confirmed
            in the world.
        classifier: the success classifier.
        gamma_report: how well Γ does in cross-validation.
        classifier_report: how well C does in cross-validation.
    """

    dataset: Dataset
    gamma: TransitionModel
    swift: TransitionModel
    classifier: SuccessClassifier
    gamma_report: TransitionReport
    classifier_report: SuccessReport


def fit_models(dataset: Dataset, seed: int) -> Knowledge:
    """Γ and C from data, hyper-parameters chosen by cross-validation."""
    gamma, gamma_report = fit_transition_model(
        dataset.percept, dataset.motion, dataset.next_percept, seed=seed
    )
    classifier, report = fit_success_classifier(dataset.grasp_percept, dataset.graspable, seed=seed)
    swift = swift_gamma(gamma, dataset)
    return Knowledge(dataset, gamma, swift, classifier, gamma_report, report)


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
        residual = data.next_percept[pick] - knowledge.swift(data.percept[pick], data.motion[pick])
    rows = torch.randint(len(residual), (len(percepts) * replicas, LOOKS), generator=generator)
    return ModelEnvironment(
        percepts.repeat_interleave(replicas, 0).to(device),
        copy.deepcopy(knowledge.swift).to(device),
        copy.deepcopy(knowledge.classifier).to(device),
        possible_with(footprint.to(device)),
        errors=residual[rows].to(device),
    )


MARGIN = 0.03  # m that a way must be clearer in the models than in the world


def possible_with(footprint: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    """MoveBase's own check on percepts: the way must be clear of the box seen around the table.

    It asks for `MARGIN` more room than the world does, so that a way which is possible in the
    models is not blocked by the noise of the world.
    """
    wider = footprint + footprint.new_tensor([-MARGIN, MARGIN, -MARGIN, MARGIN])

    def possible(percept: Tensor, motion: Tensor) -> Tensor:
        return motion_possible(motion, box_rectangle(percept[:, :4]), wider)

    return possible


MOST_NEW = 100  # transitions, and grasps that C got right, learned from one experience


def learn(knowledge: Knowledge, experience: Dataset, generator: Generator) -> Knowledge:
    """Γ and C trained on more experience, from where they stand; hyper-parameters stay.

    Of the grasps, those that C got wrong teach most and come first. The reports stay those of the
    last cross-validation.
    """
    with torch.no_grad():
        believed = knowledge.classifier(experience.grasp_percept) > 0.5
    surprise = believed != experience.graspable
    data = knowledge.dataset.extended(sampled(experience, surprise, MOST_NEW, generator))
    gamma = update_transition_model(
        knowledge.gamma, data.percept, data.motion, data.next_percept, seed=generator
    )
    classifier = update_success_classifier(
        knowledge.classifier, data.grasp_percept, data.graspable, seed=generator
    )
    return replace(
        knowledge, dataset=data, gamma=gamma, swift=swift_gamma(gamma, data), classifier=classifier
    )


def sampled(dataset: Dataset, surprise: Tensor, most: int, generator: Generator) -> Dataset:
    """At most `most` transitions, `most` surprising (L,) grasps and `most` others, at random."""
    moves = torch.randperm(len(dataset.percept), generator=generator)[:most]
    order = torch.randperm(len(dataset.graspable), generator=generator)
    grasps = torch.cat([order[surprise[order]][:most], order[~surprise[order]][:most]])
    return Dataset(
        dataset.percept[moves],
        dataset.motion[moves],
        dataset.next_percept[moves],
        dataset.grasp_percept[grasps],
        dataset.graspable[grasps],
    )


def swift_gamma(gamma: TransitionModel, dataset: Dataset) -> TransitionModel:
    """Γ with `SWIFT_CENTRES` centres at most, to search in."""
    if len(gamma.machine.centres) <= SWIFT_CENTRES:
        return gamma
    with torch.no_grad():
        return compact_transition_model(gamma, SWIFT_CENTRES, dataset.percept, dataset.motion)[0]
