"""What the robot before a table knows: its experience, and the Γ and C learned from it."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch import native
from cgtorch.data import Dataset
from cgtorch.evolution.islands import generator_of
from cgtorch.improvement.domain import Imagine
from cgtorch.models import (
    SuccessClassifier,
    SuccessReport,
    TransitionModel,
    TransitionReport,
    Verdict,
    compact_transition_model,
    fit_success_classifier,
    fit_transition_model,
    judge,
    label_coreset,
    transition_coreset,
    update_success_classifier,
    update_transition_model,
)
from cgtorch.processes import in_processes
from cgtorch.simulation import ModelEnvironment
from cgtorch.world import ClearWay
from cgtorch.world.percepts import BOX
from cgtorch.world.percepts import parted as parts_of

SWIFT_CENTRES = 128
FAMILIAR = 0.999  # share of the training transitions that are not novel
LEAST_NOVEL = 0.75  # allowed in any case: where few data are all centres, their novelty is 0
Found = TypeVar("Found")

CHANCE = 2**32  # the generator of what actions draw in the models, derived like an island's
LOOKS = 16  # motions for which errors of Γ are drawn; later ones use them again
ASIDE = 10  # every tenth row is kept out of all fits, to judge them by
MOST_TRANSITIONS, MOST_LABELS = 4000, 6000
"""Rows that are learnt from at most; of more, a coreset stays."""


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
        aside: experience that neither is ever trained on; what they learn is judged by it.
        verdicts: what was decided about Γ and C when they last learned on, None before.
    """

    dataset: Dataset
    gamma: TransitionModel
    swift: TransitionModel
    classifier: SuccessClassifier
    gamma_report: TransitionReport
    classifier_report: SuccessReport
    aside: Dataset
    verdicts: tuple[Verdict, Verdict] | None = None


def fit_models(dataset: Dataset, seed: int) -> Knowledge:
    """Γ and C from nine tenths of the data, hyper-parameters chosen by cross-validation."""
    return fit_models_meanwhile(dataset, seed, lambda _: None)[0]


def fit_models_meanwhile(
    dataset: Dataset, seed: int, more: Callable[[TransitionModel], Found], alone: bool = False
) -> tuple[Knowledge, Found]:
    """`fit_models`, and what else can be found out once Γ is fitted.

    C takes longest, so where compiled code may use more than one thread all else is done beside it.

    Args:
        dataset: what is known.
        seed: of all random choices.
        more: from Γ to anything; it must not draw from a generator that is used later.
        alone: in this process only, as what has to do with other ranks must be.
    """
    data, aside = parted(dataset)

    def part(number: int) -> Any:
        if number == 0:
            return fit_success_classifier(data.grasp_percept, data.graspable, seed=seed)
        gamma, report = fit_transition_model(
            data.percept, data.motion, data.next_percept, seed=seed
        )
        return gamma, swift_gamma(gamma, data), report, more(gamma)

    fitted = in_processes(part, 2, 1 if alone else native.threads())
    (classifier, report), (gamma, swift, gamma_report, found) = fitted
    return Knowledge(data, gamma, swift, classifier, gamma_report, report, aside), found


def parted(dataset: Dataset) -> tuple[Dataset, Dataset]:
    """The data without every tenth row, and these rows."""
    moves = torch.arange(len(dataset.percept)) % ASIDE == ASIDE - 1
    grasps = torch.arange(len(dataset.graspable)) % ASIDE == ASIDE - 1
    return taken(dataset, ~moves, ~grasps), taken(dataset, moves, grasps)


def taken(dataset: Dataset, moves: Tensor, grasps: Tensor) -> Dataset:
    """The transitions `moves` and the grasps `grasps`, indices or masks."""
    return Dataset(
        dataset.percept[moves],
        dataset.motion[moves],
        dataset.next_percept[moves],
        dataset.grasp_percept[grasps],
        dataset.graspable[grasps],
    )


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
    from those that Γ makes on its training data, so that a skill must not rely on being exact; for
    the same reason stochastic actions draw other numbers than they will in the world. A
    rollout fails where a motion is more novel to Γ than `FAMILIAR` of its training data.

    Args:
        knowledge: the models.
        percepts: (B, D) first percepts.
        footprint: (4,) of the base (m).
        replicas: at least 1.
        generator: of the errors, and of the seeds of what actions draw.
        device: where the environment runs.
    """
    gamma, data = copy.deepcopy(knowledge.swift), knowledge.dataset
    with torch.no_grad():
        pick = torch.randperm(len(data.percept), generator=generator)[:1000]
        percept, motion = data.percept[pick], data.motion[pick]
        predicted, novelty = gamma.predict_with_novelty(percept, motion)
        residual = data.next_percept[pick] - predicted
        # With another's error a box fits the table worse than any that is seen.
        imagined = predicted + residual.roll(1, 0) * can_err(predicted)
        gamma.most = torch.maximum(gamma.most, gamma.extremes(imagined, motion).amax(0))
    rows = torch.randint(len(residual), (len(percepts) * replicas, LOOKS), generator=generator)
    percepts = percepts.repeat_interleave(replicas, 0)
    errors = residual[rows] * can_err(percepts)[:, None]
    own = generator_of(generator, CHANCE)
    seeds = torch.randint(2**31, (len(percepts),), generator=own)
    return ModelEnvironment(
        percepts.to(device),
        gamma.to(device).predict_with_novelty,
        copy.deepcopy(knowledge.classifier).to(device),
        possible_with(footprint.to(device)),
        errors=errors.to(device),
        most_novel=max(LEAST_NOVEL, float(novelty.quantile(FAMILIAR))),
        seeds=seeds,
    )


def with_footprint(footprint: Tensor) -> Imagine:
    """`imagine` for a base of that footprint (4,), in m."""

    def imagined(
        knowledge: Knowledge,
        percepts: Tensor,
        replicas: int,
        generator: Generator,
        device: torch.device | str,
    ) -> ModelEnvironment:
        return imagine(knowledge, percepts, footprint, replicas, generator, device)

    return imagined


def can_err(percept: Tensor) -> Tensor:
    """(n, D) 1, or 0 for the boxes of obstacles that are not there: they are never seen."""
    _, _, boxes = parts_of(percept)
    there = (boxes != 0).any(-1).repeat_interleave(BOX, -1)
    size = percept.shape[-1] - there.shape[-1]
    return torch.cat([torch.ones_like(percept[..., :size]), there.to(percept)], -1)


MARGIN = 0.03  # m that a way must be clearer in the models than in the world


def possible_with(footprint: Tensor) -> ClearWay:
    """MoveBase's own check on percepts.

    It asks for `MARGIN` more room than the world does, so that a way which is possible in the
    models is not blocked by the noise of the world.
    """
    return ClearWay(footprint + footprint.new_tensor([-MARGIN, MARGIN, -MARGIN, MARGIN]))


MOST_NEW = 100  # transitions, and grasps that C got right, learned from one experience


def learn(knowledge: Knowledge, experience: Dataset, generator: Generator) -> Knowledge:
    """Γ and C trained on more experience, from where they stand; hyper-parameters stay.

    Of the grasps, those that C got wrong teach most and come first. A tenth of what is new is put
    aside. Either model is replaced, and its new data kept, only if its successor is no worse on
    what had been put aside before (`judge`); otherwise it stays as it was. Of more than
    `MOST_TRANSITIONS` or `MOST_LABELS` rows a coreset stays. The reports stay those of the last
    cross-validation.
    """
    with torch.no_grad():
        believed = knowledge.classifier(experience.grasp_percept) > 0.5
    surprise = believed != experience.graspable
    new, aside = parted(sampled(experience, surprise, MOST_NEW, generator))
    gamma, moves, first = _learn_transitions(knowledge, new, generator)
    classifier, grasps, second = _learn_labels(knowledge, new, generator)
    data = taken(knowledge.dataset, moves, grasps)
    yes = torch.tensor([first.accepted]), torch.tensor([second.accepted])
    data, aside = (
        old.extended(
            taken(more, yes[0].expand(len(more.percept)), yes[1].expand(len(more.graspable)))
        )
        for old, more in ((data, new), (knowledge.aside, aside))
    )
    swift = swift_gamma(gamma, data) if first.accepted else knowledge.swift
    return replace(
        knowledge,
        dataset=data,
        gamma=gamma,
        swift=swift,
        classifier=classifier,
        aside=aside,
        verdicts=(first, second),
    )


def _learn_transitions(
    knowledge: Knowledge, new: Dataset, generator: Generator
) -> tuple[TransitionModel, Tensor, Verdict]:
    """The Γ to go on with, the old transitions (m,) that stay, and the verdict."""
    old, aside = knowledge.dataset, knowledge.aside
    rows = old.percept, old.motion, old.next_percept
    moves, start = transition_coreset(knowledge.gamma, *rows, MOST_TRANSITIONS)
    more = new.percept, new.motion, new.next_percept
    both = (torch.cat([a[moves], b]) for a, b in zip(rows, more, strict=True))
    gamma = update_transition_model(start, *both, seed=generator)
    with torch.no_grad():
        before, after = (
            (model(aside.percept, aside.motion) - aside.next_percept).abs().mean(1)
            for model in (knowledge.gamma, gamma)
        )
    verdict = judge(before, after)
    if verdict.accepted:
        return gamma, moves, verdict
    return knowledge.gamma, torch.arange(len(old.percept)), verdict


def _learn_labels(
    knowledge: Knowledge, new: Dataset, generator: Generator
) -> tuple[SuccessClassifier, Tensor, Verdict]:
    """The C to go on with, the old labels (m,) that stay, and the verdict, by Brier's score."""
    old, aside = knowledge.dataset, knowledge.aside
    grasps, start = label_coreset(knowledge.classifier, old.grasp_percept, MOST_LABELS)
    classifier = update_success_classifier(
        start,
        torch.cat([old.grasp_percept[grasps], new.grasp_percept]),
        torch.cat([old.graspable[grasps], new.graspable]),
        seed=generator,
    )
    with torch.no_grad():
        before, after = (
            (model(aside.grasp_percept) - aside.graspable.float()).square()
            for model in (knowledge.classifier, classifier)
        )
    verdict = judge(before, after)
    if verdict.accepted:
        return classifier, grasps, verdict
    return knowledge.classifier, torch.arange(len(old.graspable)), verdict


def sampled(dataset: Dataset, surprise: Tensor, most: int, generator: Generator) -> Dataset:
    """At most `most` transitions, `most` surprising (L,) grasps and `most` others, at random."""
    moves = torch.randperm(len(dataset.percept), generator=generator)[:most]
    order = torch.randperm(len(dataset.graspable), generator=generator)
    grasps = torch.cat([order[surprise[order]][:most], order[~surprise[order]][:most]])
    return taken(dataset, moves, grasps)


def swift_gamma(gamma: TransitionModel, dataset: Dataset) -> TransitionModel:
    """Γ with `SWIFT_CENTRES` centres at most, to search in."""
    if len(gamma.machine.centres) <= SWIFT_CENTRES:
        return gamma
    with torch.no_grad():
        return compact_transition_model(gamma, SWIFT_CENTRES, dataset.percept, dataset.motion)[0]
