"""`cgtorch-view`: watch a skill at work in the browser."""

from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from cgtorch.commands.command import import_from_here, importing, run_command
from cgtorch.commands.completion import SCENARIOS, one_of, runs_or_skills
from cgtorch.commands.options import (
    actions_option,
    common_options,
    epilog,
    quiet_option,
    run_or_skill,
    skill_option,
    waiting,
)
from cgtorch.ground.errors import SettingsError

if TYPE_CHECKING:
    from cgtorch.tabletop.viewer.choice import Candidate

EXAMPLES = """\b
Examples:
  cgtorch-view runs/reference
  cgtorch-view runs/reference --scenarios far --seed 3
  cgtorch-view runs/reference/S1 --against runs/reference
  cgtorch-view runs/auto --skill auto-1 --scenarios general
"""


@click.command("cgtorch-view", epilog=epilog(EXAMPLES))
@run_or_skill
@click.option(
    "--against",
    metavar="RUN_OR_SKILL",
    type=click.Path(path_type=Path),
    shell_complete=runs_or_skills,
    help="Another skill, to be shown beside the first one on the same scenario.",
)
@click.option(
    "--scenarios",
    shell_complete=one_of(SCENARIOS),
    help="What is shown first: near, left, right, far or perimeter of the paper's table; general: "
    "any table, from any side; general-clutter: half of them with a box in the way. If not given, "
    "what the run is about.",
)
@click.option(
    "--count",
    type=click.IntRange(1, 10_000),
    default=40,
    show_default=True,
    help="Scenarios to choose from.",
)
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Of these."
)
@skill_option
@actions_option
@click.option("--host", default="127.0.0.1", show_default=True, help="Where to listen.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8080,
    show_default=True,
    help="If it is taken, the next free one; 0: any free one.",
)
@quiet_option
@common_options
def command(path: Path, scenarios: str | None, count: int, seed: int, **rest: Any) -> None:
    """Watch a skill at work in the browser, step by step, until Ctrl-C.

    RUN_OR_SKILL is a run's folder, which stands for its last skill, a stage's folder in it, or a
    skill file, which acts with the built-in PR2 and the default noise. The page shows the robot,
    its graph, what it perceives and what travels along the edges; there one can also choose
    another scenario, drag the object, and take any other skill of the run.
    """
    if find_spec("viser") is None:
        raise SettingsError("cgtorch-view needs package 'viser'; pip install 'cgtorch[view]'")
    with importing():
        import torch

        from cgtorch.tabletop.viewer.choice import Wish
        from cgtorch.tabletop.viewer.page import open_page, play_for_ever
        from cgtorch.tabletop.world import draw_of

    torch.set_num_threads(1)
    import_from_here(rest["actions"])
    with waiting(f"loading {path}", rest["quiet"]):
        offer = _offer(path, rest["name"], rest["actions"], scenarios)
    draw_of(offer.kind)  # there must be such scenarios
    candidates, against, other = dict(offer.candidates), None, rest["against"]
    if other is not None:
        more = _offer(other, None, rest["actions"], scenarios)
        taken = candidates if more.folder != offer.folder else ()
        names = {n: f"{n} of {other}" if n in taken else n for n in more.candidates}
        against = names[more.chosen]
        candidates = {names[n]: c for n, c in more.candidates.items()} | candidates
    wish = Wish(offer.chosen, against, offer.kind, count, seed)
    page, address = open_page(candidates, wish, rest["host"], rest["port"])
    click.echo(f"{offer.chosen} at work: {address} (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        play_for_ever(page)


class Offer(NamedTuple):
    """What a path stands for: where it is, its skill's name, its scenarios, and all its skills."""

    folder: Path
    chosen: str
    kind: str
    candidates: dict[str, "Candidate"]


def _offer(path: Path, name: str | None, actions: tuple[str, ...], scenarios: str | None) -> Offer:
    """The skills of a run, or the skill of a file."""
    from cgtorch.domains.registry import TABLETOP
    from cgtorch.runs.ledger import read_entry, read_index
    from cgtorch.runs.run import last_skill, lone_skill, open_run, stored_domain
    from cgtorch.tabletop.domain import Tabletop
    from cgtorch.tabletop.viewer.choice import Candidate

    if path.is_file():
        domain, kind, skill = lone_skill(path, actions, scenarios)
        assert isinstance(domain, Tabletop)  # noqa: S101  nothing else was asked for
        return Offer(path.resolve(), skill.name, kind, {skill.name: Candidate(skill, domain)})
    if (spec := stored_domain(path)) not in (None, TABLETOP):
        raise SettingsError(
            f"{str(path)!r} is about domain {spec!r}, and only the tabletop can be watched; see "
            "cgtorch-report"
        )
    if name is None:
        run, skill = last_skill(path, actions)
    else:
        run = open_run(path, actions)
        skill = read_entry(path, name, run.actions, run.like()).skill
    domain = run.domain
    assert isinstance(domain, Tabletop)  # noqa: S101  it is about no other
    names = [line["name"] for line in read_index(run.folder)]
    entries = {n: read_entry(run.folder, n, run.actions, run.like()).skill for n in names}
    skills = entries | {skill.name: skill}
    found = {n: Candidate(s, domain) for n, s in skills.items()}
    return Offer(run.folder.resolve(), skill.name, scenarios or run.kind, found)


def main() -> None:
    """Entry point of `cgtorch-view`."""
    run_command(command)


if __name__ == "__main__":
    main()
