"""A command whose options depend on the domain."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from cgtorch.commands.command import import_from_here
from cgtorch.commands.completion import DOMAIN
from cgtorch.domains.registry import is_code
from cgtorch.ground.errors import CgtorchError
from cgtorch.ground.files import read_json
from cgtorch.runs.settings import RunSettings


class DomainCommand(click.Command):
    """A click command that gets the options of a domain once the domain's name is known."""

    def __init__(self, *args: Any, add: Callable[[str], list[click.Option]], **kwargs: Any) -> None:
        """A command; `add` makes the options of the domain with a name."""
        super().__init__(*args, **kwargs)
        self._add = add

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """See `click.Command.parse_args`; the domain is determined first."""
        ctx.meta[DOMAIN] = spec = domain_named(args)
        import_from_here([spec])
        return super().parse_args(ctx, args)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """See `click.Command.get_params`."""
        known, made = super().get_params(ctx), f"{DOMAIN}.options"
        try:
            if made not in ctx.meta:
                ctx.meta[made] = self._add(ctx.meta.get(DOMAIN, RunSettings.domain))
        except CgtorchError as e:
            if ctx.resilient_parsing:
                return known
            raise click.UsageError(str(e)) from e
        return [*known[:-1], *ctx.meta[made], known[-1]]


def domain_named(args: list[str]) -> str:
    """The domain of a command line: the one it names, or that of the run that it names."""
    spec, run = _value(args, "--domain"), _value(args, "--resume")
    if spec is None and run is not None:
        try:
            spec = read_json(Path(run) / "run.json")["settings"]["domain"]
        except (CgtorchError, TypeError, KeyError):
            spec = None  # what is wrong with it is told once the run is opened
        if not isinstance(spec, str) or is_code(spec):
            spec = None
    return RunSettings.domain if spec is None else spec


def _value(args: list[str], option: str) -> str | None:
    for i, word in enumerate(args):
        if word == option and i + 1 < len(args):
            return args[i + 1]
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return None
