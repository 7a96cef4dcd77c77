"""Options for files that commands write."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

force_option = click.option("--force", is_flag=True, help="Replace the file if it exists.")


def output_option(what: str) -> Callable[[F], F]:
    """Decorator: the option for the file or folder to write."""
    return click.option("--output", type=click.Path(path_type=Path), required=True, help=what)
