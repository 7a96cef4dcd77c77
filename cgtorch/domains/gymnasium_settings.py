"""The settings of a Gymnasium environment as a domain."""

import json
import math
import re
from ast import literal_eval
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from cgtorch.domains.registry import REWARD
from cgtorch.domains.settings import DomainSettings, option
from cgtorch.ground.errors import SettingsError

OF_THE_RUN = "the run was made for it"
WRAPPER = r"[\w.]+:[\w.]+"


@dataclass(frozen=True)
class GymnasiumSettings(DomainSettings):
    """The environment, what skills perceive of it, and from when an episode is solved.

    In Python, `env` may be a dictionary of keyword arguments.
    """

    run_defaults: ClassVar[Mapping[str, Any]] = {
        "population": 48,
        "generations": 400,
        # The goal is a mean over fresh episodes, so short rounds test it soon.
        "attempts": 4,
        # Episodes end by themselves; this ends only graphs that never act.
        "max_transitions": 100_000,
    }

    environment: str = option(
        "CartPole-v1",
        "Id of the environment, as in the domain's name; module:ENV_ID imports the module first.",
        OF_THE_RUN,
        when="It follows from --domain gymnasium:ENV_ID.",
    )
    target_return: float = option(
        math.inf,
        "Return from which an episode counts as solved; by default the environment's threshold.",
        "W was selected by that return",
        least=-math.inf,
        most=math.inf,
        when="Give --target if the environment has no threshold.",
    )
    env: tuple[str, ...] | Mapping[str, Any] = option(
        (),
        "Keyword argument of the environment, as NAME=VALUE with a value of JSON or Python, else a "
        "text. Repeat the option for several.",
        OF_THE_RUN,
        when="Give it what you would give gymnasium.make.",
        before=(),
    )
    percepts: tuple[str, ...] = option(
        (),
        "Name or pattern (such as 'achieved_*') of parts or numbers of the observation that are "
        "percepts. Repeat the option for several; by default, all numbers are percepts.",
        OF_THE_RUN,
        when="Leave out what does not matter, as the search is then shorter.",
        before=(),
    )
    success: str = option(
        "",
        "Name in the info of a step that says whether the task has succeeded, such as is_success. "
        "By default, returns count; of an environment without a threshold, and without --target, "
        "is_success or success if random episodes have it.",
        OF_THE_RUN,
        when="Give it if success matters, and not the return.",
        before="",
    )
    success_at: str = option(
        "any",
        "With success: whether an episode is over and solved at its first step with success (any), "
        "or solved if its last step has success (last).",
        OF_THE_RUN,
        choices=("any", "last"),
        when="Use last if a skill has to stay at its goal.",
        before="any",
    )
    wrappers: tuple[str, ...] = option(
        (),
        "Function of an environment that returns it wrapped, as package.module:function. Repeat "
        "the option for several, of which the last one is outermost.",
        OF_THE_RUN,
        when="Give it to change observations, actions or rewards.",
        before=(),
    )
    reward: str = option(
        "",
        "With --models learned: function that says what steps give, as package.module:function. It "
        "gets observations, actions and next observations, each a tensor with a row for each of n "
        "steps, and returns n rewards and n bools, which steps end their episodes. By default this "
        "is learned.",
        OF_THE_RUN,
        when="Give it if you know what is rewarded, and only motion is to be learned.",
        before="",
    )
    hidden: int = option(
        8,
        "Number of units in the hidden layer of the network Aim.",
        OF_THE_RUN,
        when="Raise it if a task needs a policy that bends more.",
        most=10_000,
        before=8,
    )

    def __post_init__(self) -> None:
        """Check every value; SettingsError for one that cannot work."""
        if isinstance(self.env, Mapping):
            words = tuple(_word(str(name), value) for name, value in self.env.items())
            object.__setattr__(self, "env", words)
        super().__post_init__()
        for word in self.env:
            if not word.partition("=")[0].isidentifier() or "=" not in word:
                raise SettingsError(
                    f"env is {word!r:.60}; give NAME=VALUE, such as continuous=true"
                )
        for spec in self.wrappers:
            if not re.fullmatch(WRAPPER, spec):
                raise SettingsError(f"wrappers has {spec!r:.60}; give package.module:function")
        if self.reward and not re.fullmatch(WRAPPER, self.reward):
            raise SettingsError(f"reward is {self.reward!r:.60}; give package.module:function")

    @property
    def keywords(self) -> dict[str, Any]:
        """The keyword arguments of the environment."""
        return {name: _value(text) for name, _, text in (w.partition("=") for w in self.env)}

    @property
    def name(self) -> str:
        """The name of the domain, with all code that it imports."""
        reward = [f"{REWARD}{self.reward}"] if self.reward else []
        return "+".join([f"gymnasium:{self.environment}", *self.wrappers, *reward])


def _value(text: str) -> Any:
    """The value of a text: JSON or a Python literal, else the text."""
    for read in (json.loads, literal_eval):
        with suppress(ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            return read(text)
    return text


def _word(name: str, value: Any) -> str:
    """A keyword argument as NAME=VALUE; SettingsError if the value has no such form."""
    for text in (value, json.dumps(value)) if isinstance(value, str) else (repr(value),):
        if _value(text) == value:
            return f"{name}={text}"
    raise SettingsError(
        f"env has {name} {value!r:.60}, which cannot be stored in a run; give numbers, texts, or "
        "lists and dictionaries of them"
    )
