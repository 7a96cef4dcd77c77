"""The option `--seeds A:B` of all tools that try several seeds."""

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


class Seeds(click.ParamType[range]):
    """Seeds as a first one and one past the last, such as 0:10."""

    name = "A:B"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> range:
        """The seeds of a text; fails where it is not two numbers with a colon."""
        if isinstance(value, range):
            return value
        try:
            first, last = map(int, value.split(":"))
        except ValueError:
            self.fail(f"{value!r}; give the first seed and one past the last, such as 0:10", param)
        if not 0 <= first < last:
            self.fail(f"{value!r} holds no seed; the second number must be the larger one", param)
        return range(first, last)


def seeds_option(default: str) -> Callable[[F], F]:
    """The option with a default; the command gets a range."""
    return click.option(
        "--seeds",
        type=Seeds(),
        default=default,
        show_default=True,
        help="First, and one past the last.",
    )
