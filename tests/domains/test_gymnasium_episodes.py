"""Episodes share few environments, and the first one is enough for a film."""

from typing import Any

import numpy as np
import pytest

from cgtorch.domains import gymnasium_episodes
from cgtorch.domains.gymnasium_episodes import Episodes
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.ground.errors import DomainError

gymnasium = pytest.importorskip("gymnasium")
from line_environment import domain_of  # noqa: E402
from tiny_worlds import GOAL, Drawn  # noqa: E402

MADE: list[Any] = []


def counted(environment: Any) -> Any:
    """A wrapper that changes nothing, and notes what it was given."""
    MADE.append(environment)
    return environment


def episodes_of(name: str = GOAL, **settings: Any) -> Episodes:
    MADE.clear()
    return Episodes(
        GymnasiumSettings(environment=name, wrappers=(f"{__name__}:counted",), **settings)
    )


def test_a_film_needs_the_first_environment_alone() -> None:
    episodes = episodes_of("Tiny/Drawn-v0", env=("render_mode='rgb_array'",))
    assert episodes.modes == Drawn.metadata["render_modes"]
    episodes.begin([0, 1])
    assert len(MADE) == 2
    filmed = episodes.film(50)
    episodes.begin([3])
    assert len(MADE) == 2
    assert filmed.unwrapped is MADE[0].unwrapped
    film = filmed.reel.film("success")
    assert {frame.shape for frame in film.frames} == {(3, 50, 3)}


def test_no_more_environments_are_made_than_can_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gymnasium_episodes, "MOST", 3)
    episodes = episodes_of()
    first = episodes.begin([*range(5)])
    assert len(MADE) == 3
    assert episodes.batch == 1
    for seed, percept in enumerate(first):
        assert np.array_equal(episodes.begin([seed])[0], percept)
    assert (len(MADE), episodes.batch) == (3, 6)


def test_random_episodes_show_every_step_of_theirs_and_begin_with_their_seeds() -> None:
    episodes = episodes_of()
    shown = episodes.explored(3, 2)
    assert shown.percepts.shape == (3 * (1 + 2), len(episodes.percepts.fields))
    assert shown.rewards.shape == (3 * 2,)
    for seed in range(3):
        assert np.array_equal(shown.percepts[3 * seed], episodes.begin([seed])[0])
    again = episodes.explored(3, 2)
    assert np.array_equal(again.percepts, shown.percepts)
    assert len(MADE) == 1
    assert shown.infos == tuple(sorted(shown.infos))
    whole = episodes.explored(1, 1000)
    assert len(whole.percepts) == len(whole.rewards) + 1 < 1000, "an episode ends before"


def test_limits_and_thresholds_are_those_of_the_environment() -> None:
    made = Episodes(GymnasiumSettings(environment="CartPole-v1"))
    assert (made.most_steps, made.threshold) == (500, 475)
    tiny = episodes_of()
    assert (tiny.most_steps, tiny.threshold) == (12, None)


@pytest.mark.parametrize(
    ("wrapper", "message"),
    [
        ("tiny_worlds:lost", "wrapper 'tiny_worlds:lost' returned None; return an environment"),
        ("tiny_worlds:NOTHING", "'tiny_worlds:NOTHING' is 3; give a function of an environment"),
    ],
)
def test_what_is_no_wrapper_is_refused(wrapper: str, message: str) -> None:
    with pytest.raises(DomainError, match=message):
        Episodes(GymnasiumSettings(environment=GOAL, wrappers=(wrapper,)))


def test_the_longest_episode_that_was_left_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    episodes = domain_of(monkeypatch, {"over": lambda line: line.steps > 4}).episodes
    assert episodes.unended() == 0, "as all random episodes ended"
    for steps in (3, 2, 5):
        episodes.begin([7])
        for _ in range(steps):
            one = episodes._played[0]
            episodes.at(0, episodes.batch, len(one.actions), one.keys[-1]).play(np.zeros(1))
        assert episodes.unended() == 3
