"""`cgtorch-report`: a run as one HTML page."""

from functools import partial
from pathlib import Path

import click

from cgtorch.commands import options
from cgtorch.commands.command import run_command
from cgtorch.commands.completion import runs_or_skills

EXAMPLES = """\b
Examples:
  cgtorch-report runs/reference --output report.html
  cgtorch-report runs/auto --output report.html --force
  cgtorch-report runs/one --output one.html --actions my_package.actions:Wait
"""


@click.command("cgtorch-report", epilog=options.epilog(EXAMPLES))
@click.argument(
    "run", metavar="RUN", type=click.Path(path_type=Path), shell_complete=runs_or_skills
)
@options.output_option("The HTML file to write.")
@options.domain_option
@options.force_option
@options.common_options
def command(
    run: Path, output: Path, domain: str | None, actions: tuple[str, ...], force: bool, quiet: bool
) -> None:
    """Write one HTML page about a run that needs no other file, no script and no network.

    Its stages beside what others report, pictures of what is solved, fitness and rates over
    generations, the graphs, Γ and C, settings, versions, and how to make it again. Everything
    comes from the folder RUN; of an unfinished run the page tells what is there and what is not.
    """
    options.check_output(output, force)
    import torch

    from cgtorch.ground.files import write_bytes
    from cgtorch.report.page import report_page

    torch.set_num_threads(1)
    with options.waiting(f"drawing {run}", quiet):
        page = report_page(run, actions, domain)
    write_bytes(output, page)
    click.echo(f"{run} as a page: {output}, {len(page)} bytes")


main = partial(run_command, command)

if __name__ == "__main__":
    main()
