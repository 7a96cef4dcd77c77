"""`cgtorch-export`: write a skill, or a run's data, in a format that other programs read or run."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from cgtorch.commands import common, outputs
from cgtorch.commands.completion import SCENARIOS, one_of
from cgtorch.ground.replacing import check_output

EXAMPLES = """\b
Examples:
  cgtorch-export runs/reference --format module --output S3.pt2
  cgtorch-export runs/reference --format onnx --output S3.onnx
  cgtorch-export runs/reference --format state-machine --output skill.py
  cgtorch-export runs/reference/S1 --format dot --output S1.dot
  cgtorch-export runs/reference/S1 --format graphml --output S1.graphml
  cgtorch-export runs/auto --skill auto-1 --format json --output auto-1.json
  cgtorch-export skill.json --format mermaid --output skill.mmd --force
  cgtorch-export runs/auto --format data --output log.csv
"""
FORMATS = ("json", "module", "onnx", "state-machine", "dot", "graphml", "mermaid", "data")
ENDS = {"module": (".pt2",), "data": (".csv", ".parquet")}
"""How the name of the file has to end, where a format requires it."""


@common.command("cgtorch-export", EXAMPLES, short_help="Write a skill for other programs.")
@common.run_or_skill
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    required=True,
    help="json: a skill file; module: a torch.nn.Module for torch.export.load; onnx: the same for "
    "any ONNX runtime; state-machine: a Python file with classes to fill in; dot, graphml, "
    "mermaid: drawings as text; data: all transitions and tests of the run as a table, CSV or "
    "Parquet, for cgtorch-train --data.",
)
@outputs.output_option("The file to write.")
@common.skill_option
@common.domain_option
@click.option(
    "--scenarios",
    shell_complete=one_of(SCENARIOS),
    help="For a skill file: the kind of scenarios that the skill was evolved on. It decides what "
    "the percept contains.  [the domain's usual kind]",
)
@outputs.force_option
def command(path: Path, form: str, output: Path, force: bool, quiet: bool, **about: Any) -> None:
    """Write a skill in a format that other programs read or run, without cgtorch.

    RUN_OR_SKILL is the folder of a run (its last skill is taken), the folder of a stage in it, or
    a skill file.
    """
    check_output(output, force, path)
    ends = ENDS.get(form, (output.suffix,))
    if output.suffix not in ends:
        raise click.UsageError(
            f"--output is {str(output)!r}; give a name that ends in {' or '.join(ends)} for "
            f"--format {form}"
        )
    kind = about.pop("scenarios")
    if form == "data":
        from cgtorch.domains.data_files import write_data
        from cgtorch.runs.chosen import stored_data

        run, part, data = stored_data(path, about["name"], about["actions"], about["domain"])
        write_data(output, data, run.domain.percept, run.domain.control)
        counts = f"{len(data.percept)} transitions and {len(data.tested)} tests"
        common.say(f"data of {part}: {output}, {counts}")
        return
    from cgtorch.export import FORMATS as WRITERS
    from cgtorch.export import SIZED
    from cgtorch.ground.files import write_bytes
    from cgtorch.runs.chosen import chosen_skill

    with common.waiting(f"loading {path}", quiet):
        chosen = chosen_skill(path, kind=kind, **about)
    sizes = {"percept_size": len(chosen.domain.percept)} if form in SIZED else {}
    with common.waiting(f"exporting {chosen.skill.name} as {form}", quiet):
        written = WRITERS[form](chosen.skill, **sizes)
    write_bytes(output, written)
    common.say(f"{chosen.skill.name} as {form}: {output}, {len(written)} bytes")


main = partial(common.run_program, command)

if __name__ == "__main__":
    main()
