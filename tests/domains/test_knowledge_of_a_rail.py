"""What is known of a domain of one's own: fitted, imagined, learned on, and told."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from rail import GEAR, LAMP, PLACE, WIND, Cart, Rail, SeeingCart, driven
from support import models_of, seeded
from torch import Tensor

from cgtorch.domains.compiled_models import compiled_models
from cgtorch.domains.knowledge import Knowledge, learn_more, summary_of, taken
from cgtorch.domains.models import Models
from cgtorch.evolution import EvolutionSettings, evolve
from cgtorch.graphs import Skill
from cgtorch.ground.environment import Dataset, start_lanes
from cgtorch.simulation import ModelEnvironment, rollout
from cgtorch.training.evaluate import robust_success

PERCEPTS = Cart().world(Cart().draw("any", 5, seeded(9))).start(torch.arange(5))[1]


@pytest.fixture(scope="module")
def known() -> Knowledge:
    return models_of(Cart()).fit(driven(300, 300, 0), 0)


def test_models_are_fitted_with_the_features_of_their_domain() -> None:
    data = driven(80, 120, 1)
    knowledge = models_of(SeeingCart()).fit(data, 0)
    assert type(knowledge.gamma).__name__ == "KernelTransitionModel"
    assert len(knowledge.dataset.percept) == knowledge.gamma_report.rows == 80
    assert len(knowledge.dataset.tested) == knowledge.classifier_report.rows == 120
    assert len(knowledge.aside.percept) == len(knowledge.aside.tested) == 0
    assert knowledge.acceptances is None
    assert knowledge.gamma.features(data.percept, data.control).shape[1] == 10
    assert knowledge.classifier.features(data.tested).shape[1] == 6


def test_a_domain_is_imagined_with_its_own_controls_and_errors(known: Knowledge) -> None:
    place = models_of(Cart()).imagine(known, PERCEPTS, 2, seeded(2))
    assert isinstance(place, ModelEnvironment)
    assert (place.num_scenarios, place.percept_size, place.control_size) == (10, 4, 3)
    assert torch.equal(place.percepts, PERCEPTS.repeat_interleave(2, 0))
    assert place.compiled is compiled_models
    assert place.errors is not None
    assert place.errors[..., WIND].abs().max() < 1e-6  # of which Γ knows all
    assert place.errors[..., PLACE].abs().max() > 1e-3
    assert place.errors[..., LAMP].abs().max() <= torch.pi


class CarefulModels(Models[Cart]):
    """It cannot be pushed back, and of its lamp and its gear Γ is believed."""

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        return control[:, 0] >= 0

    def noisy(self, percept: Tensor) -> Tensor:
        exact = torch.ones_like(percept)
        exact[..., [LAMP, GEAR]] = 0
        return exact


class Careful(Cart):
    """One with these models."""

    models = CarefulModels


def test_what_a_domain_says_is_possible_and_noisy_counts(known: Knowledge) -> None:
    place: Any = models_of(Careful()).imagine(known, PERCEPTS, 1, seeded(2))
    assert not place.errors[..., [LAMP, GEAR]].any()
    assert place.errors[..., PLACE].abs().mean() > 0.005
    lanes = start_lanes(place, torch.arange(5), 0, 0)
    push = torch.tensor([[0.5, 0, 0], [-0.5, 0, 0]])[[0, 1, 0, 1, 0]]
    after, done = place.step(lanes, push)
    assert done.tolist() == [True, False, True, False, True]
    assert torch.equal(after.percept[~done], lanes.percept[~done])
    assert set(after.percept[:, GEAR].tolist()) <= {0, 1, 2}


def test_what_is_imagined_is_much_like_the_world(known: Knowledge) -> None:
    place = models_of(Cart()).imagine(known, PERCEPTS, 1, seeded(2))
    world = Cart().world(Cart().draw("any", 5, seeded(9)))
    push = torch.tensor([[0.6, -0.4, 0.0]]).expand(5, -1)
    ends = [e.step(start_lanes(e, torch.arange(5), 0, 0), push)[0].percept for e in (place, world)]
    assert float((ends[0] - ends[1])[:, PLACE].abs().mean()) < 0.5
    assert torch.allclose(ends[0][:, WIND], ends[1][:, WIND], atol=1e-5)


def test_good_data_are_taken(known: Knowledge) -> None:
    new, fresh = (driven(300, 300, s) for s in (3, 4))
    after = learn_more(known, new, seeded(5))
    assert after.acceptances is not None
    assert all(a.accepted for a in after.acceptances)
    assert len(after.dataset.percept) > len(known.dataset.percept)
    assert errors(after, fresh) < errors(known, fresh)
    assert after.gamma_report is known.gamma_report


def test_few_rows_are_all_fitted_anew(known: Knowledge) -> None:
    """With hyper-parameters of their own, and errors that are cross-validated again."""
    new, fresh = (driven(300, 300, s) for s in (3, 4))
    after = models_of(Cart()).learn(known, new, seeded(5))
    assert after.acceptances is None
    rows = len(after.dataset.percept), len(after.dataset.tested)
    assert rows == (after.gamma_report.rows, after.classifier_report.rows)
    assert rows == pytest.approx((540, 540), abs=2)
    assert rows[0] + len(after.aside.percept) == rows[1] + len(after.aside.tested) == 600
    assert errors(after, fresh) < errors(known, fresh)
    assert sum(after.gamma_report.error) < sum(known.gamma_report.error)
    again = models_of(Cart()).learn(known, new, seeded(5))
    assert torch.equal(again.gamma.machine.weights, after.gamma.machine.weights)


def errors(knowledge: Knowledge, data: Dataset) -> float:
    gamma = knowledge.gamma
    with torch.no_grad():
        return float(gamma.errors(gamma(data.percept, data.control), data.next_percept).mean())


def test_wrong_data_are_refused_and_leave_everything_as_it_was(
    known: Knowledge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cgtorch.domains.knowledge.MOST_NEW", 300)
    new = driven(300, 300, 3)
    wrong = replace(new, control=-new.control, succeeded=~new.succeeded)
    after = learn_more(known, wrong, seeded(5))
    assert after.acceptances is not None
    assert [a.accepted for a in after.acceptances] == [False, False]
    for name in ("gamma", "swift", "classifier"):
        assert getattr(after, name) is getattr(known, name)
    for name, rows in vars(known.dataset).items():
        assert torch.equal(vars(after.dataset)[name], rows)


def test_errors_of_an_angle_go_the_shorter_way() -> None:
    gamma = models_of(Cart())._transition_model()
    one, other = torch.zeros(1, 4), torch.zeros(1, 4)
    one[:, LAMP], other[:, LAMP] = 3.0, -3.0
    assert gamma.difference(one, other)[0, LAMP].item() == pytest.approx(2 * torch.pi - 6, abs=1e-6)
    assert gamma.difference(other, one)[0, LAMP].item() == pytest.approx(6 - 2 * torch.pi, abs=1e-6)


def test_the_summary_tells_of_each_number(known: Knowledge) -> None:
    told = summary_of(known)
    assert told.first
    for part in (
        " m on place, ",
        " on wind, ",
        " rad on lamp, ",
        " on gear, ",
        "the balanced accuracy of C is ",
    ):
        assert part in told.text
    assert told.text.startswith("Γ errs by ")
    rows = len(known.dataset.percept), len(known.dataset.tested)
    assert told.text.endswith("; {} transitions and {} labels".format(*rows))
    assert told.scalars["gamma/error_lamp"] == known.gamma_report.error[LAMP]
    assert told.curves["gamma"] is known.gamma_report.learning_curve


def test_a_skill_that_was_evolved_in_the_models_works_in_the_world(known: Knowledge) -> None:
    """The lamp is left alone, so that where it is turned back nothing can be expected."""
    domain, generator = Cart(), seeded(7)
    carts = domain.draw("any", 30, generator)
    carts = replace(carts, lamp=carts.lamp / 4, gear=carts.gear.clamp(min=1))
    percepts = domain.world(carts).start(torch.arange(30))[1]
    place = models_of(domain).imagine(known, percepts, 1, generator)
    settings = EvolutionSettings(population=80, capacity=8, initial_nodes=(3, 6))
    for generation in evolve(place, domain.actions(), settings, generator):
        if generation.number == 12:
            break
    graph, actions = generation.champion.graphs, domain.actions()
    tried = rollout(graph, actions, Rail(carts)).succeeded[0]
    at_once = Rail(carts).succeeded(percepts)
    assert int(tried.sum()) > int(at_once.sum())
    robust = robust_success(
        models_of(domain), Skill("stop", graph, actions), known, percepts, generator, 4
    )
    assert robust.shape == (30,)
    assert tried[robust].float().mean() > 0.6


def test_parts_of_a_dataset_are_taken_row_by_row() -> None:
    data = driven(20, 30, 0)
    some = taken(data, torch.tensor([3, 1]), torch.arange(30) < 7)
    assert torch.equal(some.control, data.control[[3, 1]])
    assert torch.equal(some.next_percept, data.next_percept[[3, 1]])
    assert torch.equal(some.tested, data.tested[:7])
    assert torch.equal(some.succeeded, data.succeeded[:7])
