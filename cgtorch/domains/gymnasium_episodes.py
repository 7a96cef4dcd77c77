"""Episodes of Gymnasium environments, which can continue from any of their earlier steps.

A Gymnasium environment keeps its state and can only continue from it, but lanes can continue from
any earlier step. So each episode has its own environment, and its actions are recorded. One that
continues from an earlier step is played again up to there, and so is one whose environment was
given to another episode.
"""

import os
import time
import weakref
from collections.abc import Callable, Sequence
from copy import deepcopy
from importlib import import_module
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cgtorch.domains.gymnasium_controls import controls_of, tried
from cgtorch.domains.gymnasium_episode import METHODS, Episode, Took, truth
from cgtorch.domains.gymnasium_explored import Explored, Look
from cgtorch.domains.gymnasium_film import Filmed
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_spaces import percepts_of
from cgtorch.domains.registry import NOT_FOUND, foreign
from cgtorch.domains.surroundings import check_defaults, surroundings
from cgtorch.ground.dry_run import failed_at, reason
from cgtorch.ground.ending import PATIENCE, at_end
from cgtorch.ground.errors import CgtorchError, DomainError, WorldError
from cgtorch.ground.own_modules import INSIDE, as_module, is_relative
from cgtorch.native.processes import counted

MOST = 64
"""Number of environments at once; see docs/decisions/interface.md."""
LIMITING = "--env max_episode_steps=300"
"""What gives an environment a limit of steps."""


class Episodes:
    """Episodes of one environment in batches, which share at most `most` copies of it.

    `percepts` and `controls` are what its observations and `actions` are made of. `threshold` is
    the return from which it counts as solved, if it has one, and `most_steps` the length of an
    episode at most. `batch` counts batches; only episodes of
    the last batch can continue. `most` is `MOST`, or how many copies could be made, and `lacking`
    says why there are no more. They are closed when nobody needs these episodes any more.
    """

    def __init__(self, settings: GymnasiumSettings) -> None:
        """Make the first environment; DomainError if it cannot be made or has other spaces."""
        self._settings = settings
        self._wrappers = [_wrapper(spec) for spec in settings.wrappers]
        self.most, self.lacking = MOST, ""
        self._open = list[tuple[int, Any]]()
        at_end(weakref.finalize(self, _close, self._open))
        self._process, self._parents = os.getpid(), dict[int, Any]()
        first, self._limit, self.threshold = self._made()
        self._having = {0: first}  # the environments of episodes, the last one used last
        self._played, self._unended = dict[int, Episode](), 0
        self._took = {method: Took() for method in METHODS}
        name, self.actions = settings.environment, _space(first, "action_space")
        seen = _space(first, "observation_space")
        self.percepts = percepts_of(seen, settings.percepts, name)
        self.controls = controls_of(self.actions, name)
        self.batch = 0
        self._starts: dict[int, tuple[Any, NDArray[Any]]] = {}

    @property
    def name(self) -> str:
        """The name of the environment."""
        return self._settings.environment

    @property
    def wrappers(self) -> tuple[str, ...]:
        """The user's wrappers of it."""
        return self._settings.wrappers

    def anew(self) -> "Episodes":
        """Episodes in other copies, which have played nothing yet; DomainError if none can be."""
        return Episodes(self._settings)

    @property
    def modes(self) -> Any:
        """The ways in which the environment can be drawn."""
        told = next(iter(self._having.values())).metadata or {}
        return told.get("render_modes") or ()

    def pace(self) -> str:
        """How long a reset and a step took in this process; "" before any."""
        each = " and ".join(
            f"a {name} took {took.seconds / took.calls:.2g} s in the mean, {took.longest:.2g} s at "
            "most"
            for name, took in self._took.items()
            if took.calls
        )
        return f"in environment {self.name!r}, {each}" if each else ""

    def film(self, width: int) -> Filmed:
        """Have the first environment filmed, of which no other is then needed."""
        filmed = Filmed(self._environment(0), width)
        self._having = {0: filmed}
        return filmed

    def __reduce__(self) -> tuple[type["Episodes"], tuple[GymnasiumSettings]]:
        """Environments are not pickled: another process makes its own."""
        return Episodes, (self._settings,)

    def begin(self, seeds: list[int]) -> list[NDArray[Any]]:
        """The first percepts (D,), not scaled, of a batch of episodes with these seeds."""
        self.batch, self._unended = self.batch + 1, self.unended()
        return [self._begun(i, seed) for i, seed in enumerate(seeds)]

    def unended(self) -> int:
        """The most steps of an episode that was left before its end."""
        left = (len(each.actions) for each in self._played.values() if not each.over)
        return max(self._unended, *left, 0)

    def first(self, seed: int) -> tuple[Any, NDArray[Any]]:
        """The environment's own state and the percept at the start of an episode."""
        known = self._starts.get(seed)
        if known is None:
            percept = self._begun(0, seed)
            known = np.array(self._having[0].unwrapped.state), percept
            self._starts[seed] = known
        return known

    def at(self, slot: int, batch: int, step: int, key: int) -> Episode:
        """An episode at an earlier step; WorldError if other actions led to it."""
        if batch != self.batch:
            raise WorldError(
                "a lane cannot go on after other lanes have begun in the same Gymnasium "
                "environment; run one batch after the other"
            )
        episode = self._played[slot]
        if step >= len(episode.keys) or episode.keys[step] != key:
            raise WorldError(
                "a lane cannot continue from this step, because its Gymnasium environment has "
                "moved on; run each lane from its start"
            )
        lost = slot not in self._having
        episode.environment = self._environment(slot)
        if lost or step < len(episode.actions):
            episode.replay(step)
        return episode

    def explored(self, count: int, most: int, names: Sequence[str] = ()) -> Explored:
        """What `count` episodes with random actions show, with at most `most` steps in each.

        `names` are looked for in infos.
        """
        actions = tried(self.actions)
        actions.seed(0)
        looks, more = list[Look](), counted("random episodes", count)
        for seed in range(count):
            looks.append(self._looked(seed, actions, most, names))
            more(1)
        return Explored.joined(looks)

    def _looked(self, seed: int, actions: Any, most: int, names: Sequence[str]) -> Look:
        """What one episode with actions drawn from a space shows."""
        percepts, rewards, infos = [self._begun(0, seed)], list[float](), set[str]()
        told = {name: list[bool]() for name in names}
        episode = self._played[0]
        while len(rewards) < most and not episode.over:
            seen, reward, _, info = episode.play(actions.sample())
            percepts.append(seen)
            rewards.append(reward)
            infos.update(key for key in info if isinstance(key, str))
            for name, truths in told.items():
                truths.append(bool(truth(info.get(name))))
        return Look(percepts, rewards, frozenset(infos), told, episode.over, episode.cut)

    def _begun(self, slot: int, seed: int) -> NDArray[Any]:
        """Begin an episode; returns its first percept."""
        about = self._settings.environment, self._environment(slot), self.percepts
        self._played[slot] = Episode(*about, seed, self._limit, took=self._took)
        return self._played[slot].begin()

    def _environment(self, slot: int) -> Any:
        """The environment of an episode: its own, or a new one, or the one used longest ago.

        A forked process leaves those of its parent alone, which may hold a window or a connection.
        Some may exist only once, because of a licence, so one that cannot be made is no error
        where others can be used.
        """
        if self._process != os.getpid():
            self._process, self._parents, self._having = os.getpid(), self._having, {}
        found = self._having.pop(slot, None)
        if found is None and len(self._having) < self.most:
            try:
                found = self._made()[0]
            except DomainError as e:
                if not self._having:
                    raise
                self.most, self.lacking = len(self._having), str(e)
        if found is None:
            found = self._having.pop(next(iter(self._having)))
        self._having[slot] = found
        return found

    def _made(self) -> tuple[Any, float, Any]:
        """A new environment, its limit of steps, and its threshold.

        The limit is kept here, which is faster than by Gymnasium's wrappers, but not with wrappers
        of the user's, which may depend on it.
        """
        import gymnasium
        from gymnasium.wrappers import OrderEnforcing, TimeLimit

        name, keywords = self._settings.environment, self._settings.keywords
        surroundings.begin()
        try:
            if module := name.rpartition(":")[0]:
                surroundings.call(
                    lambda: as_module(lambda: import_module(module)),
                    lambda: f"the import of module {module!r}",
                )
            made: Any = surroundings.call(
                lambda: as_module(
                    lambda: gymnasium.make(name, disable_env_checker=True, **keywords)
                ),
                lambda: f"the constructor of environment {name!r}",
            )
        except CgtorchError:
            raise
        except Exception as e:
            raise _refusal(name, e, forked=bool(self._parents)) from e
        threshold = getattr(made.spec, "reward_threshold", None)
        limit = _limit_of(made)
        while not self._wrappers and type(made) in (OrderEnforcing, TimeLimit):
            made = made.env
        for spec, wrap in zip(self._settings.wrappers, self._wrappers, strict=True):
            made = _wrapped(spec, wrap, made)
        self.most_steps = min(limit, _limit_of(made))
        self._open.append((os.getpid(), made))
        check_defaults(f"environment {name!r}")
        return made, float("inf") if self._wrappers else limit, threshold


def _limit_of(environment: Any) -> float:
    """The most steps of an episode, infinite if no wrapper limits them."""
    from gymnasium import Wrapper
    from gymnasium.wrappers import TimeLimit

    limit, inner = float("inf"), environment
    while isinstance(inner, Wrapper):
        if isinstance(inner, TimeLimit):
            limit = min(limit, inner._max_episode_steps)
        inner = inner.env
    return limit


def _refusal(name: str, error: Exception, forked: bool) -> DomainError:
    """The error of an environment that cannot be made, perhaps in a forked process."""
    from gymnasium.error import UnregisteredEnv

    place = failed_at(error)
    advice = "correct it there" if place else "correct that first"
    if isinstance(error, ModuleNotFoundError) and place:
        advice = "is it spelt right, and installed?"
    if isinstance(error, UnregisteredEnv | ImportError) and not place:
        advice = _not_found(name, error)
    if "No module named 'gym'" in str(error):
        advice = "port it from gym to its successor (import gymnasium as gym, and its interface)"
    if is_relative(error):
        advice = INSIDE
    if isinstance(error, TypeError) and " argument" in str(error):
        advice = "does it have these keywords, or need others (--env NAME=VALUE)?"
    if forked:
        advice += ", or use one process if only few may exist at once (--processes 1)"
    return DomainError(
        f"Gymnasium cannot make environment {name!r} ({reason(error)}){place}; {advice}"
    )


def _not_found(name: str, error: Exception) -> str:
    """What to do about an environment that is not registered, or whose module is not found."""
    module, _, own = name.rpartition(":")
    if module and not isinstance(error, ImportError):
        return (
            f"module {module!r} was imported and does not register {own!r}; is it spelt right, and "
            "does the module call gymnasium.register(id=..., entry_point=...)?"
        )
    return (
        "is it spelt right, its module given (module:ENV_ID), and that in this folder, on "
        "PYTHONPATH or installed?"
    )


def _close(environments: list[tuple[int, Any]]) -> None:
    """Close environments that this process has made, whose own errors no longer matter.

    Those that are left when it has taken too long, or when somebody interrupts it, stay open.
    """
    until = time.monotonic() + PATIENCE
    for process, environment in environments:
        if process == os.getpid() and time.monotonic() < until:
            try:
                surroundings.call(environment.close, lambda: "close() of an environment")
            except KeyboardInterrupt:
                break
            except BaseException:  # noqa: S112  SystemExit, too
                continue
    environments.clear()


def _space(environment: Any, name: str) -> Any:
    """A copy of a space, as environments may change it; DomainError for another thing."""
    from gymnasium import Space

    space = getattr(environment, name, None)
    if not isinstance(space, Space):
        raise DomainError(
            f"environment {environment!s:.60} has {name} {space!r:.60}; set one of Gymnasium's "
            "spaces in its constructor"
        )
    return deepcopy(space)


def _wrapper(spec: str) -> Callable[[Any], Any]:
    """The function "package.module:function"; DomainError if there is none."""
    entry = EntryPoint("wrapper", spec, "cgtorch.wrappers")
    found: Callable[[Any], Any] = foreign(entry.load, f"cannot import wrapper {spec!r}", NOT_FOUND)
    if not callable(found):
        raise DomainError(f"wrapper {spec!r} is {found!r:.80}; give a function of an environment")
    return found


def _wrapped(spec: str, wrap: Callable[[Any], Any], environment: Any) -> Any:
    """The wrapped environment; DomainError if it is none."""
    import gymnasium

    found = foreign(lambda: wrap(environment), f"wrapper {spec!r} fails", "correct that first")
    if not isinstance(found, gymnasium.Env):
        raise DomainError(f"wrapper {spec!r} returned {found!r:.80}; return an environment")
    return found
