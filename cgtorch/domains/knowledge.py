"""Knowledge of a domain: the data, and Γ and C learned from it."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch import native
from cgtorch.domains.compiled_models import compiled_models
from cgtorch.domains.learned_model import LearnedModel
from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.domains.success import SuccessClassifier
from cgtorch.domains.transition import TransitionModel
from cgtorch.evolution.search import derived_generator
from cgtorch.ground.environment import Dataset
from cgtorch.ground.statistics import Acceptance, accept_model
from cgtorch.improvement.events import ModelSummary
from cgtorch.native.processes import in_processes
from cgtorch.simulation import ModelEnvironment
from cgtorch.simulation.model import MOST_NOVEL, Compile, Possible

SWIFT_CENTRES = 128
FAMILIAR = 0.999  # share of the training transitions that are not novel
CHANCE = 2**32  # the generator of what actions draw in the models, derived like an island's
LOOKS = 16  # motions for which errors of Γ are drawn; later ones use them again
SPARE = 300  # least number of rows from which a share is held out
ASIDE = 10  # every tenth row is kept out of all fits, to judge them by
MOST_TRANSITIONS, MOST_LABELS = 4000, 6000
"""Maximum numbers of transitions and labels to learn from; of more, a coreset is kept."""
FEW = 1000  # rows below which models are fitted anew, which takes less than a second
SHOWN = 6  # numbers of a percept whose errors are told in a line
MOST_NEW = 100  # transitions, and tests that C got right, learned from one experience

Model = TypeVar("Model", bound=LearnedModel)


@dataclass(frozen=True)
class Knowledge:
    """Data and models; learning makes a new object.

    Attributes:
        dataset: All data on which Γ and C are trained.
        gamma: The transition model.
        swift: Γ with few centres, several times faster. Search uses it, and its results are tried
            in the world.
        classifier: The success classifier.
        gamma_report: Cross-validation of Γ.
        classifier_report: Cross-validation of C.
        aside: Held-out data, on which new models are compared with old ones.
        acceptances: Whether the last learning replaced Γ and C, None before.
    """

    dataset: Dataset
    gamma: TransitionModel
    swift: TransitionModel
    classifier: SuccessClassifier
    gamma_report: TransitionReport
    classifier_report: SuccessReport
    aside: Dataset
    acceptances: tuple[Acceptance, Acceptance] | None = None


FitSuccess: TypeAlias = Callable[[Dataset, int], tuple[SuccessClassifier, SuccessReport]]
FitTransition: TypeAlias = Callable[[Dataset, int], tuple[TransitionModel, TransitionReport]]


def fit_models(
    success: FitSuccess, transition: FitTransition, dataset: Dataset, seed: int
) -> Knowledge:
    """Γ and C from the data and a seed, by these functions.

    From `SPARE` rows on, a tenth of them is held out.
    If compiled code may use several threads and there are many rows, Γ is fitted beside C in
    another process.
    """
    many = max(len(dataset.percept), len(dataset.succeeded)) >= SPARE
    data, aside = hold_out(dataset) if many else (dataset, taken(dataset, slice(0), slice(0)))

    def part(number: int) -> Any:
        return (success, transition)[number](data, seed)

    fitted = in_processes(part, 2, native.threads() if many else 1)
    (classifier, report), (gamma, gamma_report) = fitted
    swift = swift_gamma(gamma, data)
    return Knowledge(data, gamma, swift, classifier, gamma_report, report, aside)


def hold_out(dataset: Dataset) -> tuple[Dataset, Dataset]:
    """The data without every tenth row, and these rows; of tests, every tenth of either result."""
    moves = torch.arange(len(dataset.percept)) % ASIDE == ASIDE - 1
    tests = torch.zeros_like(dataset.succeeded)
    for each in (dataset.succeeded, ~dataset.succeeded):
        tests[each.nonzero()[ASIDE - 1 :: ASIDE, 0]] = True
    return taken(dataset, ~moves, ~tests), taken(dataset, moves, tests)


def taken(dataset: Dataset, moves: Tensor | slice, tests: Tensor | slice) -> Dataset:
    """The transitions `moves` and the tests `tests`, selected by indices, masks or slices."""
    return Dataset(
        dataset.percept[moves],
        dataset.control[moves],
        dataset.next_percept[moves],
        dataset.tested[tests],
        dataset.succeeded[tests],
    )


def imagine(
    knowledge: Knowledge,
    percepts: Tensor,
    replicas: int,
    generator: Generator,
    device: torch.device | str = "cpu",
    *,
    possible: Possible,
    noisy: Callable[[Tensor], Tensor] = torch.ones_like,
    compiled: Compile | None = compiled_models,
) -> ModelEnvironment:
    """The models as an environment for percepts (B, D), each `replicas` times with other errors.

    Scenario i has the indices i · replicas … i · replicas + replicas - 1. Errors are drawn from
    those of Γ on its training data, so that a skill cannot rely on exact predictions. For the same
    reason, stochastic actions draw other numbers than in the world. A rollout fails at a control
    that is more novel to Γ than the share `FAMILIAR` of its training data.

    Args:
        knowledge: The models and their data.
        percepts: (B, D) first percepts.
        replicas: Number of scenarios per percept.
        generator: Draws the errors, and the seeds of stochastic actions.
        device: Where the environment runs.
        possible: See `ModelEnvironment`.
        noisy: Maps percepts (n, D) to 1 for numbers that Γ can get wrong, 0 for those it cannot.
        compiled: See `ModelEnvironment`.
    """
    gamma, data = copy.deepcopy(knowledge.swift), knowledge.dataset
    with torch.no_grad():
        pick = torch.randperm(len(data.percept), generator=generator)[:1000]
        percept, control = data.percept[pick], data.control[pick]
        predicted, novelty = gamma.predict_with_novelty(percept, control)
        residual = gamma.difference(predicted, data.next_percept[pick])
        # Resampled errors can leave the observed range of percepts, so it is widened.
        imagined = predicted + residual.roll(1, 0) * noisy(predicted)
        gamma.most = torch.maximum(gamma.most, gamma.extremes(imagined, control).amax(0))
    rows = torch.randint(len(residual), (len(percepts) * replicas, LOOKS), generator=generator)
    percepts = percepts.repeat_interleave(replicas, 0)
    errors = residual[rows] * noisy(percepts)[:, None]
    own = derived_generator(generator, CHANCE)
    seeds = torch.randint(2**31, (len(percepts),), generator=own)
    return ModelEnvironment(
        percepts.to(device),
        gamma.to(device).predict_with_novelty,
        copy.deepcopy(knowledge.classifier).to(device),
        possible,
        control_size=control.shape[1],
        errors=errors.to(device),
        # Where few data are all centres, their novelty is 0.
        most_novel=max(MOST_NOVEL, float(novelty.quantile(FAMILIAR))),
        seeds=seeds,
        compiled=compiled,
        chance=knowledge.classifier(percepts).to(device),
    )


def learn(
    fit: Callable[[Dataset, int], Knowledge],
    knowledge: Knowledge,
    experience: Dataset,
    generator: Generator,
) -> Knowledge:
    """Γ and C trained on additional experience.

    As long as there are fewer than `FEW` rows, both are fitted anew by `fit` to all data, with
    their hyper-parameters. Of more, they go on with `learn_more`.
    """
    every = knowledge.dataset.extended(knowledge.aside).extended(experience)
    if max(len(every.percept), len(every.succeeded)) < FEW:
        seed = int(torch.randint(2**31, (), generator=generator))
        return fit(every, seed)
    return learn_more(knowledge, experience, generator)


def learn_more(knowledge: Knowledge, experience: Dataset, generator: Generator) -> Knowledge:
    """Γ and C trained on additional experience, with the same hyper-parameters.

    Tests that C got wrong come first. A tenth of the new data is held out. A model is replaced, and
    its new data kept, only if the new model is no worse on the earlier held-out data
    (`accept_model`); otherwise it stays. If there are more than `MOST_TRANSITIONS` or `MOST_LABELS`
    rows, a coreset is kept. The reports stay those of the last cross-validation.
    """
    with torch.no_grad():
        believed = knowledge.classifier(experience.tested) > 0.5
    surprise = believed != experience.succeeded
    new, aside = hold_out(sampled(experience, surprise, MOST_NEW, generator))
    known = knowledge.dataset, new, knowledge.aside
    transitions = [(data.percept, data.control, data.next_percept) for data in known]
    tests = [(data.tested, data.succeeded) for data in known]
    gamma, moves, first = _learn(knowledge.gamma, transitions, MOST_TRANSITIONS)
    classifier, labels, second = _learn(knowledge.classifier, tests, MOST_LABELS)
    data = taken(knowledge.dataset, moves, labels)
    used = [slice(None) if each.accepted else slice(0) for each in (first, second)]
    data, aside = data.extended(taken(new, *used)), knowledge.aside.extended(taken(aside, *used))
    return replace(
        knowledge,
        dataset=data,
        gamma=gamma,
        swift=swift_gamma(gamma, data) if first.accepted else knowledge.swift,
        classifier=classifier,
        aside=aside,
        acceptances=(first, second),
    )


def _learn(
    model: Model, rows: Sequence[tuple[Tensor, ...]], most: int
) -> tuple[Model, Tensor | slice, Acceptance]:
    """The model to use, the old rows to keep, and the acceptance by held-out rows."""
    old, new, aside = rows
    kept, start = model.coreset(*old, limit=most)
    after = start.updated(*(torch.cat([a[kept], b]) for a, b in zip(old, new, strict=True)))
    with torch.no_grad():
        acceptance = accept_model(model.loss(*aside), after.loss(*aside))
    if acceptance.accepted:
        return after, kept, acceptance
    return model, slice(None), acceptance


def sampled(dataset: Dataset, surprise: Tensor, most: int, generator: Generator) -> Dataset:
    """Random rows: at most `most` transitions, `most` surprising (L,) tests, and `most` others."""
    moves = torch.randperm(len(dataset.percept), generator=generator)[:most]
    order = torch.randperm(len(dataset.succeeded), generator=generator)
    tests = torch.cat([order[surprise[order]][:most], order[~surprise[order]][:most]])
    return taken(dataset, moves, tests)


def swift_gamma(gamma: TransitionModel, dataset: Dataset) -> TransitionModel:
    """Γ with at most `SWIFT_CENTRES` centres, for the search."""
    if len(gamma.machine.centres) <= SWIFT_CENTRES:
        return gamma
    with torch.no_grad():
        return gamma.with_fewer_centres(SWIFT_CENTRES, dataset.percept, dataset.control)


def summary_of(knowledge: Knowledge) -> ModelSummary:
    """The results of cross-validation, or, after learning, whether new models were accepted."""
    rows, classifier = rows_of(knowledge), knowledge.classifier_report
    reports = {"gamma": knowledge.gamma_report, "classifier": classifier}
    if knowledge.acceptances is not None:
        said = "; ".join(map(_learned, ("Γ", "C"), knowledge.acceptances))
        scalars = {"models/rows": _moves(knowledge)}
        return ModelSummary(f"{said}; now from {rows}", scalars, reports)
    text = (
        f"Γ errs by {_errors(knowledge.gamma_report)}, "
        f"the balanced accuracy of C is {100 * classifier.balanced_accuracy:.1f} %; {rows}"
    )
    return ModelSummary(text, scalars_of(knowledge), reports, first=True)


def scalars_of(knowledge: Knowledge) -> dict[str, float]:
    """The results of cross-validation, by TensorBoard tags."""
    gamma, classifier = knowledge.gamma_report, knowledge.classifier_report
    errors = zip(gamma.coordinates, gamma.error, strict=True)
    return {
        "models/rows": _moves(knowledge),
        **{f"gamma/error_{name.replace(' ', '_')}": error for name, error in errors},
        "classifier/balanced_accuracy": classifier.balanced_accuracy,
        "classifier/calibration_error": classifier.calibration_error,
    }


def rows_of(knowledge: Knowledge) -> str:
    """The amount of data of the models, in words."""
    return f"{_moves(knowledge)} transitions and {len(knowledge.dataset.succeeded)} labels"


def _moves(knowledge: Knowledge) -> int:
    return len(knowledge.dataset.percept)


def _errors(report: TransitionReport) -> str:
    """Γ's cross-validated errors, sorted by their ratio to the error of a model without Γ."""
    rows = zip(report.error, report.baseline_error, report.coordinates, report.units, strict=True)
    worst = sorted(rows, key=lambda row: row[0] / row[1] if row[1] else 0.0, reverse=True)
    said = [f"{error:.2g}{f' {unit}' if unit else ''} on {name}" for error, _, name, unit in worst]
    more = f" and less on {len(said) - SHOWN} others (see TensorBoard)" if len(said) > SHOWN else ""
    return ", ".join(said[:SHOWN]) + more


def _learned(name: str, acceptance: Acceptance) -> str:
    """The decision about a model that was trained on more data."""
    if acceptance.accepted:
        return f"{name} was trained on more data"
    return (
        f"{name} stays as it was, since its error on earlier data would be "
        f"{acceptance.after:.4f} instead of {acceptance.before:.4f}"
    )
