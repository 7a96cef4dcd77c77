"""What random episodes of a Gymnasium environment tell before a training, and remarks on it."""

import math
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from cgtorch.domains.gymnasium_episodes import LIMITING, Episodes
from cgtorch.domains.gymnasium_explored import Explored
from cgtorch.domains.gymnasium_scaling import EVEN, Scaling, outside, scaled_by_bounds, scaling_of
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import Success
from cgtorch.ground.errors import DomainError

LOOKS = 20  # random episodes that tell the scale of numbers
STEPS = 200  # of each at most
FEW_LOOKS, FEW_STEPS = 5, 20  # where each step counts
NEARLY_ALL = 0.9  # random episodes, which a success that tells nothing has from the first step on
SINGLE = 1e-6  # the smallest difference of rewards that returns still tell, as a share
FAMILIAR = ("is_success", "success")
"""Names in the info of a step that tell of success in many environments."""


@dataclass(frozen=True)
class Known:
    """What random episodes tell before a training, which the run keeps.

    Attributes:
        scaling: The scaling of observations.
        success: What an info says of success; None if returns count.
        target: The return from which an episode is solved, if returns count.
        remark: Sentences about what was found; "" if there is nothing to say.
    """

    scaling: Scaling
    success: Success | None = None
    target: float = 0.0
    remark: str = ""


def found_out(settings: GymnasiumSettings, episodes: Episodes, target: float | None) -> Known:
    """What random episodes tell; the `target` is the return to reach, if it is known.

    DomainError if it is not known from when an episode is solved.
    """
    names = (settings.success,) if settings.success else () if target is not None else FAMILIAR
    seen = episodes.explored(LOOKS, STEPS, names)
    scaling, common = scaling_of(seen.percepts), [outside(episodes.percepts, seen.percepts)]
    common += [_too_close(episodes, seen), _without_limit(episodes, seen)]
    if target is not None and not settings.success:
        return Known(scaling, target=target, remark=_together(*common, _alike(seen)))
    own = settings.success or _familiar(settings, seen)
    about = _about(settings, own, seen)
    mean, spread = float(seen.rewards.mean()), float(seen.rewards.std())
    varies = spread > EVEN * abs(seen.rewards).max()
    told = settings.success_at == "last", mean, spread if varies else 1.0
    return Known(scaling, Success(own, *told), remark=_together(about, *common))


def sparingly_found_out(episodes: Episodes, target: float) -> Known:
    """What a few short random episodes tell, which are not given to models."""
    seen = episodes.explored(FEW_LOOKS, FEW_STEPS).percepts
    scaling = scaled_by_bounds(episodes.percepts, seen)
    return Known(scaling, target=target, remark=outside(episodes.percepts, seen))


def _familiar(settings: GymnasiumSettings, seen: Explored) -> str:
    """The name of success by itself; DomainError if infos have none that tells anything."""
    names = [name for name in FAMILIAR if name in seen.infos]
    always = {name: _always(settings, name, seen) for name in names}
    if telling := [name for name in names if not always[name]]:
        return telling[0]
    if names:
        raise DomainError(
            f"environment {settings.environment!r} tells of {names[0]} in {always[names[0]]}, so "
            "it tells nothing of a skill; give the return to reach as target (--target), or "
            "another name in its info as success (--success)"
        )
    raise DomainError(
        f"environment {settings.environment!r} names no return from which it counts as solved; "
        "give one as target (--target), or a name in its info as success (--success). A skill file "
        "does not tell it, so without these options name the folder of its run"
    )


def _about(settings: GymnasiumSettings, name: str, seen: Explored) -> str:
    """Sentences about the success of that name; DomainError if another one was meant."""
    if name not in seen.infos:
        if near := get_close_matches(name, seen.infos, 1, 0.75):
            raise DomainError(
                f"success is {name!r:.60}, which no info of {LOOKS} random episodes has; they have "
                f"{near[0]!r:.60}, so give that (--success {near[0]:.60})"
            )
        others = f"only {', '.join(seen.infos)}" if seen.infos else "as infos were empty"
        return f"No info of {LOOKS} random episodes has {name}, {others}."
    said = [] if settings.success else [f"An episode is solved by {name} in the info of a step."]
    if always := _always(settings, name, seen):
        said.append(f"{name} was true in {always}, so it may tell nothing of a skill.")
    elif 2 * (solved := seen.solved(name, settings.success_at == "last")) >= LOOKS:
        said.append(f"Random episodes are solved by {name}, too, in {solved} of {LOOKS}.")
    return " ".join(said)


def _always(settings: GymnasiumSettings, name: str, seen: Explored) -> str:
    """Which random episodes have success, if these are so many that it tells nothing, else ""."""
    at_last, episodes = settings.success_at == "last", len(seen.told)
    if not at_last and (first := seen.solved_at_once(name)) >= NEARLY_ALL * episodes:
        return f"the first step of {first} of {episodes} random episodes"
    return f"all {episodes} random episodes" if seen.solved(name, at_last) == episodes else ""


def _without_limit(episodes: Episodes, seen: Explored) -> str:
    """A remark if episodes may go on for ever, else ""."""
    if episodes.most_steps < math.inf or seen.cut:
        return ""
    random = "" if seen.ended else f", and no random episode ended within {STEPS} steps"
    return (
        f"The environment has no limit of steps{random}; an episode that does not end within the "
        "transitions of a skill (--max-transitions) has no return, so if some may not end, give a "
        f"limit ({LIMITING})."
    )


def _too_close(episodes: Episodes, seen: Explored) -> str:
    """A remark about the first whole number that varied by less than floats can tell, else ""."""
    if seen.percepts.dtype.kind not in "iu":
        return ""
    least, most = seen.percepts.min(0), seen.percepts.max(0)
    lost = (least != most) & (least.astype(np.float64) == most.astype(np.float64))
    if not lost.any():
        return ""
    at = int(lost.argmax())
    return (
        f"Random episodes showed {episodes.percepts.fields[at].name} between {least[at]} and "
        f"{most[at]}, which floats cannot tell apart, so it never varies in percepts; subtract a "
        "constant (--wrappers)."
    )


def _alike(seen: Explored) -> str:
    """A remark if rewards of random episodes are too alike for their size to be told apart."""
    least, most = float(seen.rewards.min()), float(seen.rewards.max())
    size = max(abs(least), abs(most))
    if not 0 < most - least < SINGLE * size:
        return ""
    return (
        f"Rewards of random episodes are as large as {size:g} and differ by {most - least:.2g} at "
        "most, which returns cannot tell in single precision; subtract a constant (--wrappers)."
    )


def _together(*sentences: str) -> str:
    return " ".join(each for each in sentences if each)
