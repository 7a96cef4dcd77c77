"""Dry runs: user-defined parts are tried on two rows before anything long begins.

Each error names the method, what it returned, and what it should return.
"""

import sysconfig
import traceback
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.environment import Environment, Lanes, Named, Rewarded, start_lanes
from cgtorch.ground.errors import CgtorchError, DomainError, WorldError
from cgtorch.ground.given import shown

ROWS = 2
MOTIONS = 3  # until it is said that a world repeats itself
LITTLE = 0.05  # difference that what came before may make, as a share, as in contacts of Box2D
LIBRARIES = tuple(
    Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib", "scripts")
)
"""The folders of Python's modules, and of installed packages and commands."""


def two_rows(count: int, device: torch.device | str = "cpu") -> Tensor:
    """(2,) long, the first two of `count` indices, or twice the only one."""
    return torch.tensor([0, min(1, count - 1)], device=device)


def returned(
    error: type[CgtorchError],
    who: str,
    method: Callable[..., Any],
    *given: Any,
    tried: str = "two rows",
) -> Any:
    """The result of a method; any exception becomes an `error` that names the method."""
    try:
        with torch.no_grad():
            return method(*given)
    except CgtorchError:
        raise
    except Exception as e:
        raise error(f"{who} raised {reason(e)}{failed_at(e)}, tried with {tried}") from e


def failed_at(e: BaseException) -> str:
    """Where the user's code failed, such as " in line 12 of wave.py"; "" if that is not known."""
    others = {Path(__file__).resolve().parents[1], *LIBRARIES}
    for frame in reversed(traceback.extract_tb(e.__traceback__)):
        path = Path(frame.filename)
        if not others & set(path.parents) and not path.name.startswith("<"):
            return f" in line {frame.lineno} of {path.name}"
    return ""


def reason(e: BaseException) -> str:
    """The message of an exception, in one short line."""
    try:
        said = " ".join(str(e).split())[:200]
    except Exception:  # it is the user's own, and may be wrong, too
        said = ""
    return f"{type(e).__name__}: {said}" if said else type(e).__name__


def expect(
    error: type[CgtorchError],
    who: str,
    what: str,
    value: object,
    shape: Sequence[int],
    dtype: torch.dtype,
) -> None:
    """Raise `error` unless a value is a tensor of that shape and type.

    The message begins with `who`, such as "action 'Wave': forward", and names `what` of several.
    """
    if not isinstance(value, Tensor) or value.shape != tuple(shape) or value.dtype != dtype:
        raise error(
            f"{who} returned {f'{what} as ' if what else ''}{kind(value)}; "
            f"return {kind(torch.empty(*shape, dtype=dtype))}"
        )


def kind(value: object) -> str:
    """A short description of a value."""
    if isinstance(value, Tensor):
        return f"a tensor {tuple(value.shape)} of {str(value.dtype).removeprefix('torch.')}"
    if isinstance(value, tuple) and len(value) < 5:
        return f"({', '.join(map(kind, value))})"
    return f"a {type(value).__name__}"


def expect_pair(error: type[CgtorchError], who: str, what: str, value: object) -> tuple[Any, Any]:
    """The two elements of a returned pair; `error` if it is not a pair."""
    if not isinstance(value, tuple) or len(value) != 2:
        raise error(f"{who} returned {kind(value)}; return ({what})")
    return value


def copied(lanes: Lanes) -> Lanes:
    """A copy of the lanes."""
    return Lanes(*(getattr(lanes, f.name).clone() for f in fields(Lanes)))


def expect_lanes(
    error: type[CgtorchError], who: str, lanes: Lanes, kept: Lanes, after: object
) -> None:
    """Raise `error` unless `who` left `lanes` as in the copy `kept`, and returned similar lanes."""
    if not isinstance(after, Lanes):
        raise error(f"{who} returned {kind(after)} as lanes; return Lanes")
    for f in fields(Lanes):
        was: Tensor = getattr(kept, f.name)
        new = getattr(after, f.name)
        if f.name in ("message", "memory") and getattr(new, "shape", was.shape) != was.shape:
            said = f"{kind(new)}; return {kind(was)}, or set {f.name}_size in the action's class"
            raise error(f"{who} returned lanes.{f.name} as {said}")
        expect(error, who, f"lanes.{f.name}", new, was.shape, was.dtype)
        now: Tensor = getattr(lanes, f.name)
        if not torch.equal(now.isnan(), was.isnan()) or not (now.isnan() | (now == was)).all():
            raise error(
                f"{who} changed lanes.{f.name} in place; return new lanes, as with "
                f"dataclasses.replace(lanes, {f.name}=...)"
            )


METHODS = "start", "step", "observe", "success"


def check_methods(environment: object) -> None:
    """WorldError for what is no environment at all, without a trial."""
    if isinstance(environment, type) or not all(hasattr(environment, each) for each in METHODS):
        raise WorldError(
            f"environment is {shown(environment)}; give an Environment, such as "
            "domain.world(scenarios) returns"
        )


def check_environment(environment: Environment, device: torch.device | str = "cpu") -> None:
    """Try each method of an environment on two of its scenarios; WorldError if one is wrong."""
    name, parts = type(environment).__name__, getattr(environment, "made_of", {})
    start, step, success = (f"{name}.{parts.get(m, m)}" for m in ("start", "step", "success"))
    _check_size(environment, "num_scenarios")
    scenario = two_rows(environment.num_scenarios, device)
    first = returned(WorldError, start, environment.start, scenario)
    state, percept = expect_pair(WorldError, start, "states, percepts", first)
    for attribute in ("percept_size", "control_size"):  # which may be found out by a start
        _check_size(environment, attribute)
    given = isinstance(percept, Tensor) and percept.is_floating_point()
    floats = percept.dtype if given else torch.float32
    shape = (ROWS, environment.percept_size)
    expect(WorldError, start, "percepts", percept, shape, floats)
    if not isinstance(state, Tensor) or state.dim() != 2 or len(state) != ROWS:
        raise WorldError(f"{start} returned states as {kind(state)}; return a tensor (2, S)")
    lanes = start_lanes(environment, scenario, environment.control_size, 0)
    kept = copied(lanes)
    control = percept.new_zeros(ROWS, environment.control_size)
    moved = returned(WorldError, step, environment.step, lanes, control)
    after, done = expect_pair(WorldError, step, "lanes, whether it could be done", moved)
    expect_lanes(WorldError, step, lanes, kept, after)
    expect(WorldError, step, "whether it could be done", done, (ROWS,), torch.bool)
    seen = returned(WorldError, f"{name}.observe", environment.observe, lanes)
    expect_lanes(WorldError, f"{name}.observe", lanes, kept, seen)
    found = returned(WorldError, success, environment.success, lanes)
    tested, chance = expect_pair(WorldError, success, "lanes, probabilities", found)
    expect_lanes(WorldError, success, lanes, kept, tested)
    expect(WorldError, success, "probabilities", chance, (ROWS,), floats)
    if ((chance < 0) | (chance > 1)).any():
        raise WorldError(f"{success} returned {chance.tolist()}; return probabilities")


def what_differs(environment: Environment) -> str:
    """What a checked environment shows otherwise when it is called again, or "" if nothing does."""
    name = type(environment).__name__
    once, again = (returned(WorldError, name, _shown, environment) for _ in range(2))
    return first_difference(environment, once, again, 0.0)


def what_is_shared(environment: Environment) -> str:
    """What two scenarios show otherwise when they begin in another order, or "" if nothing does.

    They are looked at after a single motion, as little differences grow.
    """
    name = type(environment).__name__
    orders = (False, 1), (True, 1)
    once, turned = (returned(WorldError, name, _shown, environment, *order) for order in orders)
    back = {what: numbers.flip(0) for what, numbers in turned.items()}
    return first_difference(environment, once, back, LITTLE)


def first_difference(
    environment: Environment, one: dict[str, Tensor], other: dict[str, Tensor], rounded: float
) -> str:
    """The first of results by name that differ by more than a share, else ""."""
    for what, numbers in one.items():
        a, b = (
            each.double().nan_to_num().flatten(1) for each in map(_rows, (numbers, other[what]))
        )
        wrong = ((a - b).abs() > rounded * torch.maximum(a.abs(), b.abs()).clamp(min=1)).nonzero()
        if len(wrong):
            row, column = wrong[0].tolist()
            where = f" {environment.begun_by(row)}" if isinstance(environment, Named) else ""
            values = f"{float(a[row, column])} and {float(b[row, column])}"
            return f"{what.format(column + 1)}{where}: {values}"
    return ""


def _rows(numbers: Tensor) -> Tensor:
    """Numbers (n,) as (n, 1), others as they are."""
    return numbers[:, None] if numbers.dim() == 1 else numbers


def _shown(
    environment: Environment, turned: bool = False, motions: int = MOTIONS
) -> dict[str, Tensor]:
    """Percepts and other results of the methods on two scenarios, by what they are."""
    size, scenario = environment.control_size, two_rows(environment.num_scenarios)
    lanes = start_lanes(environment, scenario.flip(0) if turned else scenario, size, 0)
    seen = {"number {} of the first percept": lanes.percept}
    for motion in range(1, motions + 1):
        lanes, done = environment.step(lanes, lanes.percept.new_zeros(ROWS, size))
        seen[f"whether motion {motion} could be done"] = done
        seen[f"number {{}} of the percept after motion {motion}"] = lanes.percept
        if isinstance(environment, Rewarded):
            seen[f"the return after motion {motion}"] = environment.returns(lanes)
    tested, chance = environment.success(lanes)
    return seen | {"number {} of the percept after a test": tested.percept, "success": chance}


def check_default_type(who: str) -> None:
    """DomainError if code of the user's has changed the type that torch gives to new tensors."""
    if (given := torch.get_default_dtype()) != torch.float32:
        raise DomainError(
            f"torch's default type is {given}, as {who} or your program sets it, and skills cannot "
            "be computed in it; leave it at torch.float32, and give tensors of yours their type "
            "(dtype=...)"
        )


def _check_size(environment: Environment, attribute: str) -> None:
    name = type(environment).__name__
    value = returned(WorldError, f"{name}.{attribute}", getattr, environment, attribute, None)
    if not isinstance(value, int) or value < 1:
        raise WorldError(f"{name}: {attribute} is {value!r:.40}; give a whole number from 1 on")
