"""Environments whose episodes do not repeat themselves are told."""

from typing import Any

import numpy as np
import pytest
from line_environment import Change, Line, domain_of

from cgtorch.domains.check import check_domain
from cgtorch.ground.errors import DomainError

gymnasium = pytest.importorskip("gymnasium")


@pytest.mark.parametrize("what", ["reward", "seen"])
def test_an_environment_that_does_not_repeat_itself_is_told(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    chance = np.random.default_rng(0)

    def different(line: Line) -> Any:
        late = chance.uniform() if line.steps > 1 else 0.0
        return late if what == "reward" else np.array([line.place, late])

    domain = domain_of(monkeypatch, {what: different})
    with pytest.raises(DomainError, match="gave something else when it was called twice"):
        check_domain(domain, "starts")


def test_episodes_that_share_a_state_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {"latest": 0.0}

    def seen(line: Line) -> Any:
        if not line.steps:
            kept["latest"] = line.place
        return np.array([kept["latest"], 0.5])

    domain = domain_of(monkeypatch, {"seen": seen})
    with pytest.raises(DomainError, match=r"in another order \(number 1 of the .* no state in cla"):
        check_domain(domain, "starts")


def test_a_reset_that_keeps_the_last_state_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def seen(line: Line) -> Any:
        if not line.steps:
            line.place = getattr(line, "kept", line.place)
        line.kept = line.place  # type: ignore[attr-defined]
        return np.array([line.place, 0.5])

    domain = domain_of(monkeypatch, {"seen": seen})
    with pytest.raises(DomainError, match=r"keep .* from one episode to the next|of an earlier"):
        check_domain(domain, "starts")


def test_an_action_that_is_kept_over_episodes_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    step = Line.step

    def changing(self: Line, action: Any) -> Any:
        seen, _, *more = step(self, action)
        rate = float(abs(action[0] - getattr(self, "last", 0.0)))
        self.last = float(action[0])  # type: ignore[attr-defined]
        return seen, -rate, *more

    monkeypatch.setattr(Line, "step", changing)
    told = (
        r"'Tiny/Line-v0' showed .* in a second episode \(the return after motion 1 after reset\(s"
    )
    with pytest.raises(DomainError, match=told):
        check_domain(domain_of(monkeypatch, {}), "starts")


def test_wrappers_are_named_as_what_may_not_repeat_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    normal = "gymnasium.wrappers:NormalizeReward"
    domain = domain_of(monkeypatch, {"reward": lambda line: line.place}, wrappers=(normal,))
    told = rf"'Tiny/Line-v0' with {normal} gave .*; leave out wrappers .* statistics .*, draw all"
    with pytest.raises(DomainError, match=told):
        check_domain(domain, "starts")


def test_noise_that_begins_late_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(0)
    seen: Change = lambda line: np.array(  # noqa: E731
        [line.place, chance.uniform() if line.steps > 4 else 0.5]
    )
    told = r"environment 'Tiny/Line-v0' gave .* after motion 5 after reset\(seed=.*self.np_random"
    with pytest.raises(DomainError, match=told):
        check_domain(domain_of(monkeypatch, {"seen": seen}), "starts")


@pytest.mark.parametrize("threshold", ["high", np.nan, np.inf])
def test_a_threshold_that_is_no_number_is_told_unless_a_target_is_given(
    monkeypatch: pytest.MonkeyPatch, threshold: Any
) -> None:
    monkeypatch.setattr(gymnasium.spec("Tiny/Line-v0"), "reward_threshold", threshold)
    assert domain_of(monkeypatch, {}, target_return=3.0).target_return == 3
    with pytest.raises(DomainError, match=rf"reward_threshold '?{threshold}'?; .*--target"):
        domain_of(monkeypatch, {}, target_return=np.inf)
