"""States of a MuJoCo environment, which are read and set, so an episode continues from any of them.

A state consists of that of the physics and of the environment's own numbers that change within an
episode. What changes only from start to start, such as the place of a goal or of a fixed body, is
remembered for each start. Some environments read positions that MuJoCo computed before the last
step; where that matters, they belong to the state.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cgtorch.ground.errors import WorldError

PROBES, STEPS = 3, 12
"""Starts in which it is found out what changes, and random steps in each."""
MOST_STARTS = 4096  # that are remembered
COMPUTED = ("xpos", "xquat", "site_xpos")
"""What MuJoCo computes at the beginning of a step, and environments read after it."""

Floats = NDArray[np.float64]


class MujocoStates:
    """The states of one environment, which has `model` and `data` of MuJoCo."""

    def __init__(
        self, environment: Any, reset: Callable[[int], Any], act: Callable[[int], Any]
    ) -> None:
        """Find out what a state of the environment is.

        `reset` begins an episode with a seed, and `act` carries out some action that depends on a
        number, and returns what is then observed. WorldError if an episode that is set back to an
        earlier state does not repeat itself.
        """
        import mujoco

        self._mujoco, self._environment, self._reset = mujoco, environment, reset
        self._spec = mujoco.mjtState.mjSTATE_INTEGRATION
        self._physics = mujoco.mj_stateSize(environment.model, self._spec)
        self._own: dict[str, tuple[int, ...]] = {}
        self._fixed: list[str] = []
        self._starts: dict[int, tuple[dict[str, Any], dict[str, Floats], Any, Floats]] = {}
        self._at: int | None = None
        self._computed: tuple[str, ...] = ()
        self._probe(act)
        if not self._repeats(act):
            self._computed = COMPUTED
            if not self._repeats(act):
                raise WorldError(
                    f"{type(environment).__name__} does not repeat itself from a state that was "
                    "set; it keeps something that is no number, so run it without set states"
                )

    @property
    def size(self) -> int:
        """The length of a state."""
        own = sum(int(np.prod(shape)) for shape in self._own.values())
        data = self._environment.data
        return self._physics + own + sum(getattr(data, name).size for name in self._computed)

    @property
    def model(self) -> Any:
        """MuJoCo's model."""
        return self._environment.model

    @property
    def data(self) -> Any:
        """MuJoCo's data, which are the present state."""
        return self._environment.data

    def start(self, seed: int) -> tuple[Floats, Any]:
        """The state at the start with a seed, and what is observed there."""
        if seed not in self._starts:
            if len(self._starts) >= MOST_STARTS:
                self._starts.pop(next(iter(self._starts)))
            observation = self._reset(seed)
            own, model = _numbers(self._environment), self._environment.model
            fixed = {name: getattr(model, name).copy() for name in self._fixed}
            self._starts[seed] = own, fixed, observation, self.read()
            self._at = seed
        _, _, observation, state = self._starts[seed]
        return state, observation

    def read(self) -> Floats:
        """The present state (`size`,)."""
        environment, own = self._environment, vars(self._environment)
        state = np.empty(self.size)
        self._mujoco.mj_getState(
            environment.model, environment.data, state[: self._physics], self._spec
        )
        end = self._physics
        for name, shape in self._own.items():
            begin, end = end, end + int(np.prod(shape))
            state[begin:end] = np.nan if own[name] is None else np.ravel(own[name])
        for name in self._computed:
            value = getattr(environment.data, name)
            begin, end = end, end + value.size
            state[begin:end] = value.ravel()
        return state

    def write(self, state: Floats, seed: int) -> None:
        """Continue from a state (`size`,) of an episode that began with a seed."""
        environment, mj = self._environment, self._mujoco
        if self._at != seed:
            self.start(seed)
            own, fixed, _, _ = self._starts[seed]
            vars(environment).update({name: _copy(value) for name, value in own.items()})
            for name, value in fixed.items():
                getattr(environment.model, name)[:] = value
            self._at = seed
        end = self._physics
        for name, shape in self._own.items():
            begin, end = end, end + int(np.prod(shape))
            vars(environment)[name] = _value(state[begin:end], shape, vars(environment)[name])
        physics = state[: self._physics].copy()
        # mj_forward changes what the next step is warmed up with.
        mj.mj_setState(environment.model, environment.data, physics, self._spec)
        mj.mj_forward(environment.model, environment.data)
        mj.mj_setState(environment.model, environment.data, physics, self._spec)
        for name in self._computed:
            value = getattr(environment.data, name)
            begin, end = end, end + value.size
            value[:] = state[begin:end].reshape(value.shape)

    def _probe(self, act: Callable[[int], Any]) -> None:
        """Find the numbers that change within an episode, and those that change between starts."""
        environment, first = self._environment, dict[str, Floats]()
        for seed in range(PROBES):
            self._reset(seed)
            for name in _arrays(environment.model):
                value = getattr(environment.model, name)
                known = first.setdefault(name, value.copy())
                if not np.array_equal(known, value, equal_nan=True):
                    self._fixed.append(name)
            before = _numbers(environment)
            for step in range(STEPS):
                act(step)
            after = _numbers(environment)
            for name, value in after.items():
                if name not in before or not np.array_equal(before[name], value):
                    self._own[name] = np.shape(value)
        self._fixed = sorted(set(self._fixed))

    def _repeats(self, act: Callable[[int], Any]) -> bool:
        """Whether the second half of an episode is the same after another one began."""
        self._starts.clear()
        self.start(0)
        self.write(self._starts[0][3], 0)
        for step in range(STEPS):
            act(step)
        middle = self.read()
        once = [_flat(act(STEPS + step)) for step in range(STEPS)]
        self.start(1)
        self.write(self._starts[1][3], 1)
        act(0)
        self.write(middle, 0)
        again = [_flat(act(STEPS + step)) for step in range(STEPS)]
        return all(map(np.array_equal, once, again))


def _arrays(model: Any) -> list[str]:
    """The names of a model's arrays of real numbers."""
    names = (name for name in dir(model) if not name.startswith("_"))
    values = ((name, getattr(model, name, None)) for name in names)
    return [n for n, v in values if isinstance(v, np.ndarray) and v.dtype == np.float64]


def _numbers(environment: Any) -> dict[str, Any]:
    """Copies of an environment's own attributes that are numbers or arrays of numbers."""
    return {name: _copy(value) for name, value in vars(environment).items() if _is_number(value)}


def _is_number(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiub"
    return isinstance(value, float | int | bool | np.number | np.bool_)


def _copy(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value


def _value(part: Floats, shape: tuple[int, ...], now: Any) -> Any:
    """The attribute that is stored as a part of a state, of the type that it has now."""
    if len(part) and np.isnan(part).all():
        return None
    if isinstance(now, np.ndarray) or shape:
        return part.reshape(shape).astype(getattr(now, "dtype", np.float64))
    return float(part[0]) if now is None else type(now)(part[0])


def _flat(observation: Any) -> Floats:
    """An observation as numbers, whatever its form."""
    if isinstance(observation, dict):
        return np.concatenate([_flat(value) for value in observation.values()])
    if isinstance(observation, tuple):
        return np.concatenate([_flat(value) for value in observation])
    return np.ravel(np.asarray(observation, dtype=np.float64))
