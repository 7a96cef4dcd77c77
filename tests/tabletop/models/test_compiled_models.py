"""What compiled code says of machines, Γ, C and motions, against torch."""

from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import first_percepts, random_classifier, random_gamma, random_models
from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.native import available, constants
from cgtorch.svm import SVR
from cgtorch.svm.rbf import machine_structure, machine_values, predict_rbf
from cgtorch.tabletop.models import compiled_models
from cgtorch.tabletop.models.success import compiled_machine
from cgtorch.tabletop.world import ClearMotion, clear_motion, motion_possible
from cgtorch.tabletop.world.clear_motion import motion_possible_in_torch

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

FLOATS = {torch.float32: 1e-4, torch.float64: 1e-11}


@given(
    seed=st.integers(0, 2**31),
    rows=st.integers(1, 40),
    centres=st.integers(1, 70),
    features=st.integers(1, 12),
    outputs=st.integers(1, 9),
    dtype=st.sampled_from(list(FLOATS)),
)
@settings(max_examples=60, deadline=None)
def test_values_are_those_of_the_definition(
    seed: int, rows: int, centres: int, features: int, outputs: int, dtype: torch.dtype
) -> None:
    generator = seeded(seed)
    x = torch.randn(rows, features, generator=generator).to(dtype)
    machine = (
        torch.randn(centres, features, generator=generator).to(dtype),
        torch.randn(centres, outputs, generator=generator).to(dtype),
        torch.randn(outputs, generator=generator).to(dtype),
        torch.tensor(0.4, dtype=dtype),
    )
    found = machine_values(x, *machine)
    assert found is not None
    kernel = (-0.4 * (x.double()[:, None] - machine[0].double()).square().sum(-1)).exp()
    torch.testing.assert_close(
        found[0].double(), kernel @ machine[1].double() + machine[2], atol=FLOATS[dtype], rtol=0
    )
    wanted = predict_rbf(x, *machine)
    torch.testing.assert_close(found[1], wanted[1], atol=FLOATS[dtype], rtol=1e-4)
    one = machine_values(x[-1:], *machine)
    assert one is not None
    assert torch.equal(one[0], found[0][-1:])
    assert torch.equal(one[1], found[1][-1:])


def test_compiled_models_know_the_base_and_are_none_where_something_else_is_asked() -> None:
    models = random_models(1, 5, "yaw", 1)
    found = compiled_models(models)
    assert found is not None
    assert (found.name, found.dtype) == ("tabletop", torch.float64)
    body, footprint = found.structure.body, FOOTPRINT
    assert (body.bx, body.by) == pytest.approx((0.0, 0.0))
    assert (body.hx, body.hy) == pytest.approx([footprint[1] + clear_motion.CLEARANCE] * 2)
    assert body.farthest == clear_motion.MAX_TRANSLATION

    def other(**changed: Any) -> Any:
        every = {
            "gamma": models.gamma, "classifier": models.classifier, "possible": models.possible,
            "percepts": models.percepts, "control_size": 3, **changed,
        }  # fmt: skip
        return compiled_models(cast("Any", SimpleNamespace(**every)))

    assert other() is not None
    gamma, classifier = models.gamma.__self__, models.classifier  # type: ignore[attr-defined]
    single = ClearMotion(torch.tensor(FOOTPRINT))
    for name, value in {
        "gamma": gamma.predict_in_torch, "classifier": classifier.predict_in_torch,
        "possible": single, "percepts": models.percepts.float(), "control_size": 2,
    }.items():  # fmt: skip
        assert other(**{name: value}) is None, name
    assert other(possible=lambda percept, motion: True) is None
    assert other(gamma=lambda percept, motion: gamma(percept, motion)) is None


def test_a_machine_is_compiled_for_percepts_that_there_is_room_for() -> None:
    most, machine = (
        constants("engine_limits", torch.float64)["MOST_PERCEPT"],
        random_gamma(1).machine,
    )
    percepts = torch.zeros(2, most + 1).double()
    assert compiled_machine(machine, percepts[:, :most]) is not None
    assert compiled_machine(machine, percepts) is None
    assert compiled_machine(machine, percepts[:, :7].float()) is None
    assert compiled_machine(machine, percepts[:, :7], percepts.float()) is None
    assert compiled_machine(SVR().double(), percepts[:, :7]) is None
    machine.weights, machine.bias = machine.weights.repeat(1, 2), machine.bias.repeat(2)
    assert compiled_machine(machine, percepts[:, :7]) is None


def test_far_rows_and_rows_that_are_not_numbers() -> None:
    machine = torch.zeros(3, 2), torch.ones(3, 1), torch.tensor([0.25]), torch.tensor(1.0)
    x = torch.tensor([[0.0, 0], [1e3, 0], [1e30, 1e30], [torch.nan, 0], [0, torch.inf]])
    found = machine_values(x, *machine)
    assert found is not None
    assert found[0][:3, 0].tolist() == pytest.approx([3.25, 0.25, 0.25])
    assert found[0][3:].isnan().all()


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("percept", ["box", "yaw"])
def test_motions_may_turn_by_any_angle(dtype: torch.dtype, percept: str) -> None:
    generator, model = seeded(3), random_gamma(3)
    first = first_percepts(3, 40, percept, 1).to(dtype)
    turns = torch.logspace(-6, 5.5, 40).repeat(2)
    turns[40:] *= -1
    turns[[3, 43]] = torch.tensor([torch.pi, torch.pi / 2])
    motion = torch.randn(80, 3, generator=generator)
    motion[:, 2] = turns
    motion, first = motion.to(dtype), first.repeat(2, 1)
    given = first.double(), motion.double()
    wanted = model.predict_in_torch(*given)
    found = model.to(dtype).predict_with_novelty(first, motion)
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one.double(), other, atol=10 * FLOATS[dtype], rtol=0)


@given(seed=st.integers(0, 2**31), count=st.integers(1, 60), dtype=st.sampled_from(list(FLOATS)))
@settings(max_examples=40, deadline=None)
def test_no_row_depends_on_others_to_the_bit(seed: int, count: int, dtype: torch.dtype) -> None:
    generator, first = seeded(seed), first_percepts(3, 60, "box", 1)
    gamma, classifier = random_gamma(3).to(dtype), random_classifier(4, first).to(dtype)
    first, motion = first.to(dtype), torch.randn(60, 3, generator=generator).to(dtype)
    motion[::7, 2] *= 1e6
    motion[5] = torch.nan
    some = torch.randperm(60, generator=generator)[:count]
    pairs = [
        *zip(
            gamma.predict_with_novelty(first, motion),
            gamma.predict_with_novelty(first[some], motion[some]),
            strict=True,
        ),
        (classifier(first), classifier(first[some])),
    ]
    for whole, part in pairs:
        torch.testing.assert_close(part, whole[some], atol=0, rtol=0, equal_nan=True)


def test_there_is_no_room_for_machines_of_any_size() -> None:
    def fits(features: int, outputs: int, centres: int = 5) -> bool:
        weights, bias = torch.zeros(centres, outputs), torch.zeros(outputs)
        made = machine_structure(torch.zeros(centres, features), weights, bias, torch.tensor(1.0))
        return made is not None

    assert fits(64, 16)
    assert not fits(65, 1)
    assert not fits(1, 17)
    assert not fits(1, 1, centres=0)


@pytest.mark.parametrize("things", [1, 3])
def test_the_same_motions_are_possible(things: int) -> None:
    generator, footprint = seeded(things), torch.tensor(FOOTPRINT, dtype=torch.float64)
    motion = 2 * torch.randn(20_000, 3, generator=generator).double()
    motion[::5, 2], motion[3, 0], motion[4, 2] = 0, torch.nan, torch.inf
    place = torch.randn(20_000, things, 3, generator=generator).double()
    size = (2 * torch.rand(20_000, things, 2, generator=generator).double() - 0.2).clamp_min(0)
    scene = torch.cat([place, size], -1)
    found = motion_possible(motion, scene, footprint)
    assert torch.equal(found, motion_possible_in_torch(motion, scene, footprint))
    assert 0.05 < float(found.double().mean()) < 0.95


def grid(*columns: tuple[float, ...]) -> Tensor:
    """Every combination of these numbers, in double precision."""
    parts = [torch.tensor(column, dtype=torch.float64) for column in columns]
    return torch.cartesian_prod(*parts)


def test_motions_that_just_touch_are_as_possible_as_in_torch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All lengths are whole multiples of an eighth of a metre, of which nothing is rounded."""
    monkeypatch.setattr(clear_motion, "CLEARANCE", 0.125)
    footprint = torch.tensor([-0.375, 0.625, -0.25, 0.25], dtype=torch.float64)
    motion = grid((-1.0, -0.5, 0.0, 0.25, 1.0), (-1.0, -0.25, 0.0, 0.75), (0.0, -0.5))
    motion = torch.cat([motion, torch.tensor([[1.5, 2.0, 0], [1.5, -2.125, 0]]).double()])
    place = grid((-1.0, -0.5, 0.0, 0.75, 1.0, 1.5), (-1.0, -0.5, 0.0, 0.625, 1.0), (0.0,))
    size = grid((0.0, 0.25, 1.0), (0.0, 0.5, 1.0))
    thing = torch.cat([place.repeat_interleave(len(size), 0), size.repeat(len(place), 1)], 1)
    every = motion.repeat_interleave(len(thing), 0), thing.repeat(len(motion), 1)[:, None]
    found = motion_possible(*every, footprint)
    assert torch.equal(found, motion_possible_in_torch(*every, footprint))
    assert 0.2 < float(found.double().mean()) < 0.8
    assert bool(found[every[0][:, 1] == 2.0].any())
    assert not bool(found[every[0][:, 1] == -2.125].any())
