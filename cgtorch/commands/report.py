"""`cgtorch-report`: write one HTML page about a run."""

from functools import partial
from pathlib import Path

import click

from cgtorch.commands import common, outputs
from cgtorch.commands.completion import runs_or_skills
from cgtorch.ground.replacing import check_output

EXAMPLES = """\b
Examples:
  cgtorch-report runs/reference --output report.html
  cgtorch-report runs/auto --output report.html --force
  cgtorch-report runs/one --output one.html --actions my_package.actions:Wait
"""


@common.command("cgtorch-report", EXAMPLES)
@click.argument("run", metavar="RUN", type=common.A_PATH, shell_complete=runs_or_skills)
@outputs.output_option("The HTML file to write.")
@common.domain_option
@outputs.force_option
def command(
    run: Path, output: Path, domain: str | None, actions: tuple[str, ...], force: bool, quiet: bool
) -> None:
    """Write one HTML page about a run. The page needs no other file, no script and no network.

    It shows the stages beside published results, pictures of the solved scenarios, fitness and
    mutation rates over generations, the graphs, the quality of Γ and C, settings, versions, and
    the commands that make the run again. Everything is read from the folder RUN. The last skill is
    tried again on fresh scenarios, to show where it fails, and why. For an unfinished run, the page
    says which parts are missing.
    """
    check_output(output, force, run)
    common.draw_without_display()
    import torch

    from cgtorch.ground.files import write_bytes
    from cgtorch.report.page import report_page
    from cgtorch.runs.stored_run import read_run
    from cgtorch.training.explained import explained

    torch.set_num_threads(1)
    with common.waiting(f"loading {run}", quiet):
        opened = read_run(run, actions, domain)
    with common.waiting(f"looking at failures of {run}", quiet):
        why = explained(opened)
    with common.waiting(f"drawing {run}", quiet):
        page = report_page(opened, why)
    write_bytes(output, page)
    common.say(f"{run} as a page: {output}, {len(page)} bytes")


main = partial(common.run_program, command)

if __name__ == "__main__":
    main()
