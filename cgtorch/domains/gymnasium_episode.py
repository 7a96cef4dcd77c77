"""One episode of a Gymnasium environment, whose answers are copied and checked.

Environments are the user's own code, so here is where their errors and their numbers enter.
"""

import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.domains.gymnasium_spaces import Percepts
from cgtorch.domains.surroundings import check_defaults, surroundings
from cgtorch.ground.dry_run import failed_at, kind, reason
from cgtorch.ground.errors import CgtorchError, WorldError

PRIME = 1_000_003
KEYS = 2**48  # so that keys are whole numbers in float64
METHODS = {"reset": "reset(self, *, seed=None, options=None)", "step": "step(self, action)"}
FORMS = {
    "reset": (2, "(observation, info)"),
    "step": (5, "(observation, reward, terminated, truncated, info)"),
}
"""What methods return: the number of parts, and their names."""
ENDS = False, True
"""What terminated and truncated can be; a number is one of them if it is equal."""
CHOOSY = r"legal|valid|allowed|mask|\bmove"
"""Words of environments in which not every action can be chosen at any time."""


@dataclass
class Took:
    """How often an environment was called, for how many seconds in all, and at most."""

    calls: int = 0
    seconds: float = 0.0
    longest: float = 0.0

    def add(self, seconds: float) -> None:
        """Count one more call."""
        self.calls += 1
        self.seconds += seconds
        self.longest = max(self.longest, seconds)


@dataclass
class Episode:
    """One episode in progress, which is over after at most `limit` steps.

    Observations are given as the numbers (D,) of `percepts`. `keys` identify the sequence of
    actions that led to each step; the first is that of the start. `took` is how long calls took.
    `over` is whether it has ended, and `cut` whether it did so because it had become too long.
    """

    name: str
    environment: Any
    percepts: Percepts
    seed: int
    limit: float = math.inf
    actions: list[Any] = field(default_factory=list)
    keys: list[int] = field(default_factory=list)
    over: bool = False
    cut: bool = False
    took: Mapping[str, Took] = field(default_factory=lambda: {name: Took() for name in METHODS})

    def begin(self) -> NDArray[Any]:
        """Start again; returns the first observation. WorldError as for `play`."""
        self.actions, self.keys, self.over = [], [], False
        seen, _ = self._asked("reset", lambda: self.environment.reset(seed=self.seed))
        check_defaults(self.where)
        self.keys.append(self.seed % KEYS)
        return seen

    def play(self, action: Any, control: bytes = b"") -> tuple[NDArray[Any], float, bool, Any]:
        """The observation and reward after an action, whether the episode is over, and the info.

        The action was made from `control`, by which it is known again. WorldError if the
        environment fails, or returns something else than Gymnasium expects.
        """
        self.actions.append((_kept(action), control))
        seen, gained, *ends, info = self._asked("step", lambda: self.environment.step(action))
        self.keys.append((self.keys[-1] * PRIME + crc32(control)) % KEYS)
        try:
            # Unlike `float`, this takes no text.
            reward = math.fsum((gained.detach() if isinstance(gained, Tensor) else gained,))
            swapped = isinstance(gained, bool | np.bool_) and isinstance(ends[0], float)
            if swapped or ends[0] not in ENDS or ends[1] not in ENDS:
                raise ValueError("neither true nor false")
            over, self.cut = bool(ends[0]) or bool(ends[1]), bool(ends[1])
        except (TypeError, ValueError):
            said = kind((gained, *ends))
            raise WorldError(
                f"{self.where} gave reward, terminated and truncated as {said}; Gymnasium expects "
                "a number, and true or false twice; a wrapper can make that (wrappers, --wrappers)"
            ) from None
        except OverflowError:
            raise WorldError(
                f"{self.where} gave a reward too large for a float; give finite rewards"
            ) from None
        if not math.isfinite(reward):
            raise WorldError(f"{self.where} gave reward {reward}; give finite rewards")
        if not (type(info) is dict or isinstance(info, Mapping)):
            raise WorldError(
                f"{self.where} returned {kind(info)} as info; Gymnasium expects a dict"
            )
        self.over = over or len(self.actions) >= self.limit
        return seen, reward, self.over, info

    def replay(self, steps: int) -> None:
        """Play again up to a step."""
        before = self.actions[:steps]
        self.begin()
        for one in before:
            self.play(*one)

    @property
    def where(self) -> str:
        """The environment, the seed, and the step that is played."""
        return self._where()

    def _where(self) -> str:
        now = f"step {len(self.actions)} after " if self.actions else ""
        return f"environment {self.name!r} in {now}reset(seed={self.seed})"

    def _asked(self, method: str, call: Callable[[], Any]) -> tuple[Any, ...]:
        """What a method returns, its first part as numbers; WorldError if it has another form."""
        began = perf_counter()
        try:
            found = surroundings.call(call, self._where)
        except (CgtorchError, KeyboardInterrupt):
            raise
        except BaseException as e:  # SystemExit, too, as it would end the program without a word
            place = failed_at(e)
            inside = place or not isinstance(e, TypeError)
            advice = "correct it there" if inside else f"declare it as {METHODS[method]}"
            if inside and method == "step" and re.search(CHOOSY, str(reason(e)), re.IGNORECASE):
                advice += ", as any action of its space may come, and masks in infos are not read"
            raise WorldError(f"{self.where} raised {reason(e)}{place}; {advice}") from e
        self.took[method].add(perf_counter() - began)
        parts, form = FORMS[method]
        if not isinstance(found, tuple) or len(found) != parts:
            raise WorldError(f"{self.where} returned {kind(found)}; Gymnasium expects {form}")
        return self._numbers(found[0]), *found[1:]

    def _numbers(self, seen: Any) -> NDArray[Any]:
        """The numbers (D,) of an observation."""
        try:
            numbers = self.percepts.of(seen)
            finite = np.isfinite(numbers)
        except CgtorchError:
            raise
        except Exception as e:  # whatever Gymnasium raises for a value of another space
            raise WorldError(
                f"{self.where} showed {kind(seen)} ({reason(e)}); make it a member of its "
                "observation_space"
            ) from e
        if np.count_nonzero(finite) < finite.size:  # a fifth of the time of `all`
            at = int(finite.argmin())
            raise WorldError(
                f"{self.where} showed {self.percepts.fields[at].name} as {numbers[at]}; show "
                "finite numbers, leave this one out (percepts, --percepts), or wrap it (--wrappers)"
            )
        return numbers


def truth(value: Any) -> bool | None:
    """Whether a value in an info is true, or above 0.5; None if it is no number."""
    with suppress(TypeError, ValueError):
        number = np.asarray(value, dtype=np.float64)  # perhaps an array of one
        if number.size == 1 and not np.isnan(number).any():
            return bool(number.item() > 0.5)
    return None


def _kept(action: Any) -> Any:
    """A copy of an action, which may be changed in place; `deepcopy` takes 10 µs for a number."""
    if isinstance(action, np.ndarray) and action.dtype != object:
        return action.copy()
    return action if isinstance(action, int | float | np.generic) else deepcopy(action)
