"""Counted shares in words."""

from typing import Any

from cgtorch.ground.interval import wilson


def counted(score: dict[str, Any]) -> str:
    """How many succeeded of how many."""
    return f"{score['succeeded']} of {score['tried']}"


def share_of(score: dict[str, Any]) -> str:
    """The same as a share, with its confidence interval."""
    return share(score["succeeded"], score["tried"])


def share(succeeded: int, tried: int) -> str:
    """A share with its 95 % confidence interval."""
    if not tried:
        return "0 of 0"
    low, high = wilson(succeeded, tried, 0.95)
    return f"{succeeded} of {tried} = {succeeded / tried:.1%} (95 %: {low:.1%} to {high:.1%})"


def interval(score: dict[str, Any]) -> str:
    """The 95 % confidence interval of a share."""
    low, high = wilson(score["succeeded"], score["tried"], 0.95)
    return f"95 %: {low:.1%} to {high:.1%}"
