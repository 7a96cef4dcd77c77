"""What Gymnasium environments do wrong is told with the seed and the step, and data are copied."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from line_environment import Change, Line, domain_of
from support import seeded

from cgtorch.domains.check import check_domain
from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_controls import controls_of, tried
from cgtorch.domains.gymnasium_scaling import scaling_of
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.registry import make_domain
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.environment import start_lanes
from cgtorch.ground.errors import DomainError, WorldError

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.spaces import Box, Dict, Discrete, Tuple  # noqa: E402


def raising(error: BaseException) -> Change:
    def fail(line: Line) -> Any:
        raise error

    return fail


class Slow:
    """An observation that is being read when the time ends."""

    def __array__(self, *given: Any, **named: Any) -> Any:
        raise BudgetSpentError("the time is over")


def test_the_end_of_the_time_is_no_fault_of_an_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(BudgetSpentError, match=r"^the time is over$"):
        domain_of(monkeypatch, {"seen": later(Slow())})


class MumbledError(Exception):
    """An error that cannot be printed."""

    def __str__(self) -> str:
        raise ValueError("no words")


def later(change: Any) -> Change:
    """Something else from the third step on."""
    return lambda line: change if line.steps > 2 else np.array([line.place, 0.5])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"seen": later(np.array([0, np.nan]))},
            r"in step 3 after reset\(seed=0\) showed observation 2 as nan; .* \(percepts.* wrap it",
        ),
        (
            {"seen": lambda line: np.array([-np.inf, 0])},
            r"in reset\(seed=0\) showed .* 1 as -inf",
        ),
        (
            {"seen": later(np.zeros(3))},
            r"in step 3 .* has 3 numbers, not Box\(-9.0.*; make it a m",
        ),
        ({"seen": later("here")}, r"in step 3 .* showed a str .*of type <U4.*make it"),
        ({"reward": lambda line: np.nan}, r"in step 1 .* gave reward nan; give finite rewards"),
        ({"reward": lambda line: np.inf}, "gave reward inf; give finite"),
        (
            {"reward": lambda line: np.ones(2)},
            r"gave reward.* as \(a ndarray, a bool, a bool\); Gymnasium expects a number.*--wrap",
        ),
        ({"over": lambda line: np.zeros(2)}, r"as \(a float, a ndarray, a bool\).* true or false"),
        ({"over": lambda line: "no"}, r"as \(a float, a str, a bool\)"),
        (
            {"over": lambda line: 0.5, "reward": lambda line: True},
            r"as \(a bool, a float, a bool\)",
        ),
        ({"over": lambda line: np.nan}, r"as \(a float, a float, a bool\); .* true or false twice"),
        ({"over": lambda line: 0.0, "reward": lambda line: False}, "as .a bool, a float, a bool"),
        ({"over": lambda line: 2}, r"as \(a float, a int, a bool\); .* true or false twice"),
        ({"reward": raising(ValueError("Illegal move"))}, "correct it there, as any action of its"),
        ({"reset": raising(ValueError("Illegal move"))}, "correct it there$"),
        ({"seen": lambda line: np.array([1j, 0])}, r"in reset.* a ndarray .*of type complex128"),
        ({"reward": raising(MumbledError())}, r"in step 1 .* raised MumbledError in line"),
        ({"info": lambda line: None}, "in step 1 .* returned a NoneType as info; .* a dict"),
        (
            {"step": lambda line: (0, 0.0, True, {})},
            r"returned \(a int, .*; Gymnasium .* \(obs",
        ),
        (
            {"reset": lambda line: np.zeros(2)},
            r"in reset.* a ndarray; .* \(observation, info",
        ),
        (
            {"reset": lambda line: None},
            r"a NoneType; Gymnasium expects \(observation, info",
        ),
        (
            {"reward": raising(RuntimeError("too hot"))},
            r"in step 1 after reset\(seed=0\) raised RuntimeError: too hot in line \d+ of test_gym",
        ),
        (
            {"reset": raising(KeyError("no map"))},
            r"in reset.* raised KeyError: 'no map' in line",
        ),
        ({"reward": lambda line: "1"}, r"as \(a str, a bool, a bool\); Gymnasium expects a number"),
        ({"over": lambda line: "0"}, r"as \(a float, a str, a bool\); Gymnasium expects a number"),
        ({"reward": raising(SystemExit(3))}, "in step 1 .* raised SystemExit: 3 in line"),
        ({"seen": raising(TypeError("a text"))}, "TypeError: a text in line .*; correct it there"),
    ],
)
def test_what_goes_wrong_is_told_where_it_does(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Change], message: str
) -> None:
    with pytest.raises(WorldError, match=f"environment 'Tiny/Line-v0' .*{message}"):
        domain_of(monkeypatch, changes)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(), (1,)])
def test_numbers_may_be_tensors_and_arrays(
    monkeypatch: pytest.MonkeyPatch, size: tuple[int, ...]
) -> None:
    changes: dict[str, Change] = {
        "reward": lambda line: torch.full(size, 2.0, requires_grad=True),
        "over": lambda line: np.full(size, line.steps > 1),
    }
    seen = domain_of(monkeypatch, changes).episodes.explored(1, 9)
    assert (seen.rewards.tolist(), seen.ended, seen.cut) == ([2.0, 2.0], True, False)


def test_other_kinds_of_scenarios_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DomainError, match="Gymnasium has no scenarios 'far'; use one of starts"):
        domain_of(monkeypatch, {}).draw("far", 2, seeded(0))


def test_methods_without_the_arguments_of_gymnasium_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Line, "reset", lambda self: (np.zeros(2), {}))
    advice = (
        r"unexpected keyword argument 'seed'; declare it as reset\(self, \*, seed=None, options"
    )
    with pytest.raises(WorldError, match=advice):
        domain_of(monkeypatch, {})


def test_what_goes_wrong_in_a_training_is_told_with_its_seed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    domain = domain_of(monkeypatch, {})
    starts = domain.draw("starts", 3, seeded(0))
    world = domain.world(starts)
    lanes = start_lanes(world, torch.arange(3), 1, 0)
    lanes, _ = world.step(lanes, torch.zeros(3, 1))
    seed = int(starts.seed[1])
    monkeypatch.setattr(Line, "changes", {"reward": lambda line: 1 / (line.np_random_seed - seed)})
    with pytest.raises(WorldError, match=rf"in step 2 after reset\(seed={seed}\) raised ZeroDiv"):
        world.step(lanes, torch.zeros(3, 1))


def test_returns_that_are_too_large_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = domain_of(monkeypatch, {"reward": lambda line: 7e37})
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    lanes = start_lanes(world, torch.arange(1), 1, 0)
    lanes, _ = world.step(lanes, torch.zeros(1, 1))
    with pytest.raises(WorldError, match=r"in step 2 .* a return of 1\.4e\+38; .* below 1e\+38"):
        world.step(lanes, torch.zeros(1, 1))


@pytest.mark.parametrize("bad", [None, 3])
def test_what_is_no_space_is_told(monkeypatch: pytest.MonkeyPatch, bad: Any) -> None:
    def init(self: Line) -> None:
        own(self)
        self.action_space = bad

    own = Line.__init__
    monkeypatch.setattr(Line, "__init__", init)
    with pytest.raises(DomainError, match=f"has action_space {bad}; set one of Gymnasium's spaces"):
        domain_of(monkeypatch, {})


def test_an_environment_that_changes_the_working_folder_changes_only_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "own").mkdir()
    monkeypatch.chdir(tmp_path)
    seen = set[str]()

    def moved(line: Line) -> Any:
        if line.steps == 2:
            os.chdir(tmp_path / "own")
        seen.add(Path.cwd().name)
        return 1.0

    domain = domain_of(monkeypatch, {"reward": moved})
    assert Path.cwd() == tmp_path
    assert seen == {tmp_path.name, "own"}
    seen.clear()
    domain.episodes.explored(2, 1)
    assert seen == {"own"}
    assert Path.cwd() == tmp_path
    back: dict[str, Change] = {"reward": lambda line: os.chdir(tmp_path) or 1.0}
    domain_of(monkeypatch, back)
    seen.clear()
    domain_of(monkeypatch, {"reward": lambda line: seen.add(Path.cwd().name) or 1.0})
    assert seen == {tmp_path.name}


@pytest.mark.parametrize("good", [np.nan, "yes", np.zeros(2)])
def test_success_that_is_no_number_is_told_where(
    monkeypatch: pytest.MonkeyPatch, good: Any
) -> None:
    domain = domain_of(monkeypatch, {}, success="good")
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    lanes = start_lanes(world, torch.arange(1), 1, 0)
    monkeypatch.setattr(Line, "changes", {"info": lambda line: {"good": good}})
    with pytest.raises(WorldError, match=r"the info of environment .* in step 1 after .* has good"):
        world.step(lanes, torch.zeros(1, 1))


def test_numbers_that_are_not_asked_for_may_be_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    changes: dict[str, Change] = {"seen": lambda line: np.array([line.place, np.nan])}
    assert len(domain_of(monkeypatch, changes, percepts=("observation 1",)).percept) == 1


def test_an_environment_may_tell_nothing_of_how_it_is_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    domain = domain_of(monkeypatch, {})
    monkeypatch.setattr(Line, "metadata", None)  # as robosuite's GymWrapper has it
    assert tuple(domain.episodes.modes) == ()


def test_arrays_are_copied_on_their_way_in_and_out(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, plain = np.zeros(2), domain_of(monkeypatch, {})

    def same(line: Line) -> Any:
        kept[:] = line.place, 0.5
        return kept

    domain = domain_of(monkeypatch, {"seen": same})
    assert torch.equal(domain.known.scaling.scale, plain.known.scaling.scale)

    def spoilt(self: Line, action: Any) -> Any:
        found = step(self, action)
        action[:] = 0
        return found

    step = Line.step
    monkeypatch.setattr(Line, "step", spoilt)
    world = domain.world(domain.draw("starts", 2, seeded(0)))
    first = start_lanes(world, torch.arange(2), 1, 0)
    one, _ = world.step(first, torch.ones(2, 1))
    two, _ = world.step(one, torch.ones(2, 1))
    again, _ = world.step(one, torch.ones(2, 1))  # played again up to there
    assert torch.equal(again.percept, two.percept)
    assert (two.percept[:, 0] > one.percept[:, 0]).all()
    assert (one.percept[:, 0] > first.percept[:, 0]).all()


@pytest.mark.parametrize("size", [1e-300, 1e-9, 1.0, 1e38, 1e300])
def test_percepts_are_scaled_whatever_their_size(size: float) -> None:
    plain = np.stack([np.linspace(-1, 1, 9), np.full(9, 7.0), 1e8 + np.linspace(0, 1, 9)], 1)
    known, found = scaling_of(plain), scaling_of(plain * size)
    assert (found.scale / size)[[0, 2]].tolist() == pytest.approx(known.scale[[0, 2]].tolist())
    assert found.scale[1] == known.scale[1] == 1
    assert (found.centre / size).tolist() == pytest.approx(known.centre.tolist())


def test_numbers_without_bounds_are_tried_near_one() -> None:
    far = np.finfo(np.float32).max
    space = Tuple([Box(-far, far, (3,), np.float32), Dict(a=Box(0, np.inf, (3,)), b=Discrete(2))])
    near = tried(space)
    near.seed(0)
    drawn = [near.sample() for _ in range(200)]
    assert all(space.contains(one) for one in drawn)
    both = np.stack([one[0] for one in drawn]), np.stack([one[1]["a"] for one in drawn])
    assert 0.9 < both[0].std() < 1.1
    assert 0.9 < both[1].mean() < 1.1
    fields = controls_of(space, "Far-v0").fields
    assert [(f.low, f.high) for f in fields[::3]] == [(-np.inf, np.inf), (0, np.inf), (-1, 1)]


def test_numbers_that_cannot_vary_are_no_controls() -> None:
    space = Box(np.array([-1, 0.5, -2]), np.array([1, 0.5, 2]), dtype=np.float64)
    controls = controls_of(space, "Point-v0")
    assert [field.name for field in controls.fields] == ["action 1", "action 3"]
    assert np.asarray(controls.actions(np.array([[0.25, 9]]))).tolist() == [[0.25, 0.5, 2]]


def test_gymnasium_s_own_vectors_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    domain: Any = make_domain("gymnasium:CartPole-v1")
    assert isinstance(domain, Gymnasium)
    assert domain.vector is not None
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    lanes = start_lanes(world, torch.arange(1), 2, 0)
    made, wrong = domain.vector._of_size(1), (np.full((1, 4), np.nan), *[np.zeros(1, bool)] * 3, {})
    monkeypatch.setattr(made, "step", lambda action: wrong)
    with pytest.raises(WorldError, match=r"vectorised environment 'CartPole-v1' showed .* not fin"):
        world.step(lanes, torch.zeros(1, 2))


def played(domain: Any, steps: int) -> tuple[bool, float]:
    """Whether an episode is over after so many steps, and its success."""
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    lanes = start_lanes(world, torch.arange(1), 1, 0)
    for _ in range(steps):
        lanes, _ = world.step(lanes, torch.zeros(1, 1))
    return bool(world.over(lanes)), float(world.success(lanes)[1])


def test_an_episode_ends_at_its_limit_or_when_it_is_cut_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    domain = domain_of(monkeypatch, {})
    assert [played(domain, steps)[0] for steps in (5, 6)] == [False, True]

    def cut(line: Line) -> Any:
        return np.array([line.place, 0.5]), 1.0, False, line.steps == 3, {}

    domain = domain_of(monkeypatch, {"step": cut})
    assert [played(domain, steps)[0] for steps in (2, 3)] == [False, True]


@pytest.mark.parametrize(("target", "solved"), [(6.0, 1.0), (6.001, 0.0), (5.0, 1.0)])
def test_an_episode_is_solved_by_its_target_or_more_at_its_end(
    monkeypatch: pytest.MonkeyPatch, target: float, solved: float
) -> None:
    domain = domain_of(monkeypatch, {}, target_return=target)
    assert played(domain, 6) == (True, solved)
    assert played(domain, 5) == (False, 0.0)


def test_a_vector_that_is_cut_off_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    domain: Any = make_domain("gymnasium:CartPole-v1")
    world = domain.world(domain.draw("starts", 1, seeded(0)))
    lanes = start_lanes(world, torch.arange(1), 2, 0)
    made, no, yes = domain.vector._of_size(1), np.zeros(1, bool), np.ones(1, bool)
    for ends in ((no, yes), (yes, no), (no, no)):
        found = (np.zeros((1, 4)), np.ones(1), *ends, {})
        monkeypatch.setattr(made, "step", lambda action, found=found: found)
        after, _ = world.step(lanes, torch.zeros(1, 2))
        assert bool(world.over(after)) == bool(ends[0] | ends[1])


def test_what_came_before_may_make_a_little_difference() -> None:
    """Box2D solves contacts in an order that depends on what it has simulated before."""
    pytest.importorskip("Box2D")
    assert check_domain(Gymnasium(GymnasiumSettings("BipedalWalkerHardcore-v3")), "starts")


def test_spaces_that_an_environment_changes_later_stay_as_they_were(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    domain = domain_of(monkeypatch, {})
    own = domain.episodes._environment(0).unwrapped
    for space in (own.action_space, own.observation_space):
        monkeypatch.setattr(space, "low", space.high)
    assert domain.episodes.controls.actions(np.full((1, 1), -0.5)).tolist() == [[-0.5]]


def test_names_in_an_info_that_are_no_texts_tell_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    changes: dict[str, Change] = {"info": lambda line: {3: 1, None: 2, "good": True}}
    assert domain_of(monkeypatch, changes).episodes.explored(1, 1).infos == ("good",)


def test_a_reward_beyond_a_float_is_told_where(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        WorldError, match=r"in step 1 after reset\(seed=0\) gave a reward too large"
    ):
        domain_of(monkeypatch, {"reward": lambda line: 10**400})
