"""`cgtorch` lists all commands and runs any of them, as in `cgtorch train`."""

from functools import partial
from importlib import import_module
from importlib.metadata import distribution

import click

from cgtorch.commands.common import completion_option, epilog, run_program

PREFIX = "cgtorch-"
EXAMPLES = """\b
Examples:
  cgtorch train
  cgtorch train --help
  cgtorch evaluate runs/reference
  cgtorch view runs/reference
"""


class AllCommands(click.Group):
    """The group of all commands of the installed package, each imported when it is used.

    `cgtorch NAME` and `cgtorch-NAME` are the same command.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of all commands, without their prefix."""
        names = distribution("cgtorch").entry_points.select(group="console_scripts").names
        return sorted(name.removeprefix(PREFIX) for name in names if name.startswith(PREFIX))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command with that name, or None."""
        scripts = distribution("cgtorch").entry_points.select(group="console_scripts")
        for script in scripts.select(name=PREFIX + cmd_name):
            command: click.Command = import_module(script.module).command
            return command
        return None


@click.group("cgtorch", cls=AllCommands, invoke_without_command=True, epilog=epilog(EXAMPLES))
@click.version_option(package_name="cgtorch")
@completion_option
@click.pass_context
def command(context: click.Context) -> None:
    """Evolve robot skills as computational graphs of actions.

    `cgtorch train` without further options evolves a first skill in some ten seconds. Each command
    below has its own --help, and is also available under its own name, such as cgtorch-train.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


main = partial(run_program, command)

if __name__ == "__main__":
    main()
