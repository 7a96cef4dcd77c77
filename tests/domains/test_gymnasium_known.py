"""What random episodes tell before a training: what is refused, and what is remarked upon."""

from typing import Any

import numpy as np
import pytest
from line_environment import Change, Line, domain_of

from cgtorch.domains.gymnasium_known import LOOKS
from cgtorch.ground.errors import DomainError

gymnasium = pytest.importorskip("gymnasium")

NO_TARGET = {"target_return": np.inf}
UNTOLD = (
    "The environment has no limit of steps{}; an episode that does not end within the transitions "
    "of a skill (--max-transitions) has no return, so if some may not end, give a limit (--env "
    "max_episode_steps=300)."
)


def unlimited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gymnasium.spec("Tiny/Line-v0"), "max_episode_steps", None)


def infos(tell: Change, name: str = "success") -> dict[str, Change]:
    return {"info": lambda line: {name: tell(line), "latency": 0.01}}


def test_an_environment_without_a_limit_of_steps_is_remarked_upon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends: dict[str, Change] = {"over": lambda line: line.steps > 3}
    assert not domain_of(monkeypatch, ends).known.remark
    unlimited(monkeypatch)
    assert domain_of(monkeypatch, ends).known.remark == UNTOLD.format("")
    at: dict[str, Change] = {"seen": lambda line: np.array([0.5, 0.5])}
    never = ", and no random episode ended within 200 steps"
    assert domain_of(monkeypatch, at).known.remark == UNTOLD.format(never)
    assert not domain_of(monkeypatch, at, env={"max_episode_steps": 300}).known.remark


def test_an_environment_that_cuts_episodes_off_by_itself_has_a_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unlimited(monkeypatch)

    def cut(line: Line) -> Any:
        return np.array([line.place, 0.5]), 1.0, False, line.steps == 9, {}

    assert not domain_of(monkeypatch, {"step": cut}).known.remark


def limited(environment: Any) -> Any:
    """A wrapper that ends episodes."""
    return gymnasium.wrappers.TimeLimit(environment, 400)


def test_a_wrapper_may_be_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    unlimited(monkeypatch)
    still: dict[str, Change] = {"seen": lambda line: np.array([0.5, 0.5])}
    domain = domain_of(monkeypatch, still, wrappers=("test_gymnasium_known:limited",))
    assert domain.episodes.most_steps == 400
    assert not domain.known.remark


def test_a_limit_of_the_entry_point_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    unlimited(monkeypatch)
    monkeypatch.setattr(gymnasium.spec("Tiny/Line-v0"), "entry_point", lambda: limited(Line()))
    domain = domain_of(monkeypatch, {"seen": lambda line: np.array([0.5, 0.5])})
    assert domain.episodes.explored(1, 500).ended
    assert not domain.known.remark


@pytest.mark.parametrize("name", ["success", "is_success"])
@pytest.mark.parametrize(
    ("tell", "where"),
    [
        (lambda line: True, "in the first step of 20 of 20 random episodes"),
        (lambda line: line.steps == 4, "in all 20 random episodes"),
    ],
)
def test_success_that_random_episodes_always_have_is_not_taken_by_itself(
    monkeypatch: pytest.MonkeyPatch, name: str, tell: Change, where: str
) -> None:
    told = rf"tells of {name} {where}, so it tells nothing .* target \(--target\), or another name"
    with pytest.raises(DomainError, match=told):
        domain_of(monkeypatch, infos(tell, name), **NO_TARGET)
    remark = domain_of(monkeypatch, infos(tell, name), success=name).known.remark
    assert remark == f"{name} was true {where}, so it may tell nothing of a skill."


def test_another_familiar_name_is_taken_if_it_tells_something(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    both: dict[str, Change] = {"info": lambda line: {"is_success": True, "success": line.place > 9}}
    known = domain_of(monkeypatch, both, **NO_TARGET).known
    assert known.success.name == "success"
    assert known.remark == "An episode is solved by success in the info of a step."


def test_success_at_the_last_step_may_be_there_from_the_first_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    upright = infos(lambda line: line.steps < 5)
    known = domain_of(monkeypatch, upright, success_at="last", **NO_TARGET).known
    assert known.success.at_last
    with pytest.raises(DomainError, match="first step of 20 of 20"):
        domain_of(monkeypatch, upright, **NO_TARGET)


def test_how_often_random_episodes_are_solved_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    near = infos(lambda line: line.steps == 3 and line.place < 0.5)
    known = domain_of(monkeypatch, near, success="success").known
    seen = [
        one["success"]
        for one in domain_of(monkeypatch, near).episodes.explored(LOOKS, 200, ("success",)).told
    ]
    solved = sum(any(each) for each in seen)
    assert LOOKS // 2 <= solved < LOOKS
    assert known.remark == f"Random episodes are solved by success, too, in {solved} of {LOOKS}."
    rare = infos(lambda line: line.place > 9)
    assert not domain_of(monkeypatch, rare, success="success").known.remark


def test_a_name_like_one_in_the_infos_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    told = r"success is 'reach', which no info .*; they have 'reached', so .* \(--success reached\)"
    with pytest.raises(DomainError, match=told):
        domain_of(monkeypatch, infos(lambda line: False, "reached"), success="reach")
    remark = domain_of(
        monkeypatch, infos(lambda line: False, "reached"), success="won"
    ).known.remark
    assert remark == "No info of 20 random episodes has won, only latency, reached."


@pytest.mark.parametrize(("size", "alike"), [(1.0, False), (1e4, False), (1e9, True)])
def test_rewards_that_are_alike_for_their_size_are_remarked_upon(
    monkeypatch: pytest.MonkeyPatch, size: float, alike: bool
) -> None:
    domain = domain_of(monkeypatch, {"reward": lambda line: size + line.place})
    assert ("subtract a constant (--wrappers)" in domain.known.remark) == alike
    assert not domain_of(monkeypatch, {"reward": lambda line: size}).known.remark


def test_whole_numbers_that_differ_by_less_than_floats_can_tell_are_remarked_upon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stamped(first: int) -> dict[str, Change]:
        return {"seen": lambda line: np.array([3 - line.steps, first + 10 * line.steps])}

    remark = domain_of(monkeypatch, stamped(1_764_000_000_000_000_000)).known.remark
    assert (
        "showed observation 2 between 1764000000000000000 and 1764000000000000060, which floats "
        "cannot tell apart, so it never varies in percepts; subtract a constant (--wrappers)."
    ) in remark
    assert "never varies" not in domain_of(monkeypatch, stamped(1_764_000_000)).known.remark
