"""`cgtorch-view`: watch a skill at work in the browser."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cgtorch.commands import common, outputs
from cgtorch.commands.completion import runs_or_skills
from cgtorch.commands.interrupts import interrupts
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.replacing import check_output

if TYPE_CHECKING:
    from cgtorch.runs.chosen import Chosen
    from cgtorch.tabletop.viewer.timeline import Candidate

EXAMPLES = """\b
Examples:
  cgtorch-view runs/reference
  cgtorch-view runs/reference --scenarios far --seed 3
  cgtorch-view runs/reference/S1 --against runs/reference
  cgtorch-view runs/auto --skill auto-1 --scenarios general
  cgtorch-view runs/reference --world mujoco
  cgtorch-view runs/cartpole
  cgtorch-view runs/reference --film skill.webp
  cgtorch-view runs/push --film push.gif --seed 3
"""


@common.command("cgtorch-view", EXAMPLES, short_help="Watch a skill at work in the browser.")
@common.run_or_skill
@click.option(
    "--against",
    metavar="RUN_OR_SKILL",
    type=common.A_PATH,
    shell_complete=runs_or_skills,
    help="A second skill, shown beside the first one on the same scenario.",
)
@common.scenario_options(
    "The kind of scenarios shown first: near, left, right, far and perimeter (the paper's "
    "table), general (any table, from any side) or general-clutter (half of them with a box in "
    "the way).  [the run's]",
    count="Number of scenarios to choose from.",
    seed="Seed of the scenarios and of their noise.",
    most=10_000,
)
@common.skill_option
@common.domain_option
@common.world_option
@click.option(
    "--film",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write an animated picture (.gif or .webp) of the skill on the first scenario on "
    "which it moves anything instead, and exit. Any domain that can draw has one; the tabletop has "
    "it in physics.",
)
@outputs.force_option
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@common.number_option(
    "--port",
    click.IntRange(0, 65535),
    8080,
    "Port to listen on. If it is taken, the next free one is used. 0: any free one.",
)
def command(path: Path, scenarios: str | None, count: int, seed: int, **rest: Any) -> None:
    """Watch a skill at work in the browser, step by step, until Ctrl-C.

    RUN_OR_SKILL is the folder of a run (its last skill is taken), the folder of a stage in it, or
    a skill file, which acts with the built-in PR2 and the default noise. On the page you can choose
    another scenario, and take any other skill of the run.

    The page of the tabletop shows the robot in a scene, the graph, the percept and the message, and
    you can drag the object. The page of any other domain shows the pictures that the domain draws,
    and beside them the nodes, percepts and controls. With --film, a skill of any domain that can
    draw is shown in an animated picture.
    """
    other, quiet = rest["against"], rest["quiet"]
    if rest["film"] is not None:
        _film(rest["film"], path, scenarios, count, seed, rest)
        return
    if _draws_itself(path, rest["domain"]):
        _played(path, scenarios, count, seed, rest)
        return
    if find_spec("viser") is None:
        raise SettingsError("cgtorch-view needs package 'viser'; pip install 'cgtorch[view]'")
    with common.importing():
        import torch

    torch.set_num_threads(1)
    about = rest["actions"], scenarios, rest["world"]
    with common.waiting(f"loading {path}", quiet):
        chosen, candidates = _offer(path, rest["name"], *about)
    with common.importing():
        from cgtorch.tabletop.viewer.page import Wish, open_page, play_for_ever
        from cgtorch.tabletop.world import draw_of

    draw_of(chosen.kind)  # there must be such scenarios
    against = None
    if other is not None:
        another, more = _offer(other, None, *about)
        taken = candidates if _folder(other, another) != _folder(path, chosen) else ()
        names = {n: f"{n} of {other}" if n in taken else n for n in more}
        against = names[another.skill.name]
        candidates = {names[n]: c for n, c in more.items()} | candidates
    wish = Wish(chosen.skill.name, against, chosen.kind, count, seed)
    page, address = open_page(candidates, wish, rest["host"], rest["port"])
    with interrupts.awaited():
        common.say(f"{chosen.skill.name} at work: {address} (Ctrl-C ends it)")
        play_for_ever(page)


def _draws_itself(path: Path, domain: str | None) -> bool:
    """Whether a run or a skill file is about another domain than the tabletop."""
    from cgtorch.domains.registry import TABLETOP
    from cgtorch.runs.chosen import stored_domain

    spec = domain if path.is_file() else stored_domain(path)
    return spec not in (None, TABLETOP)


def _played(path: Path, kind: str | None, count: int, seed: int, rest: dict[str, Any]) -> None:
    """Show a skill of another domain than the tabletop in the browser."""
    if rest["against"] is not None or rest["world"] is not None:
        raise SettingsError("--against and --world are for the tabletop; leave them out")
    common.draw_without_display()
    with common.importing():
        import torch

        from cgtorch.commands.playing import play
        from cgtorch.runs.chosen import chosen_skill

    torch.set_num_threads(1)
    with common.waiting(f"loading {path}", rest["quiet"]):
        chosen = chosen_skill(path, rest["name"], rest["actions"], kind, rest["domain"])
    play(chosen, count, seed, rest["host"], rest["port"])


def _film(
    film: Path, path: Path, kind: str | None, count: int, seed: int, rest: dict[str, Any]
) -> None:
    """Write an animated picture of a skill."""
    if film.suffix not in (".gif", ".webp"):
        raise SettingsError(f"--film is {str(film)!r}; give a name that ends in .gif or .webp")
    check_output(film, rest["force"], path, "--film")
    common.draw_without_display()
    with common.importing():
        import torch

        from cgtorch.domains.domain import Adaptable, in_world
        from cgtorch.domains.film import WIDTH, animated
        from cgtorch.ground.files import write_bytes
        from cgtorch.runs.chosen import chosen_skill
        from cgtorch.training.evaluate import drawn

    torch.set_num_threads(1)
    with common.waiting(f"loading {path}", rest["quiet"]):
        chosen = chosen_skill(path, rest["name"], rest["actions"], kind, rest["domain"])
    skill, domain, world = chosen.skill, chosen.domain, rest["world"]
    if world is not None or isinstance(domain, Adaptable):
        domain = in_world(domain, world or "mujoco")  # where the tabletop is drawn
    scenarios = drawn(skill, domain, chosen.kind, count, seed)
    with common.waiting(f"filming {skill.name}", rest["quiet"]):
        made = domain.pictures(domain).film(skill, scenarios, WIDTH)
        data = animated([made], film.suffix[1:]) if made else b""
    if made is None:
        raise SettingsError(
            f"{type(domain).__name__} draws nothing in this world, so leave --film out; a domain "
            "draws in Pictures.film, an environment of Gymnasium if it has render mode "
            "'rgb_array', and the tabletop in physics (--world mujoco)"
        )
    write_bytes(film, data)
    common.say(f"{skill.name} ends in {made.end}: {film}, {len(data)} bytes")


def _folder(path: Path, chosen: "Chosen") -> Path:
    return (path if chosen.run is None else chosen.run.folder).resolve()


def _offer(
    path: Path,
    name: str | None,
    actions: tuple[str, ...],
    scenarios: str | None,
    world: str | None,
) -> tuple["Chosen", dict[str, "Candidate"]]:
    """The skill of a path, and all skills of its run."""
    from cgtorch.domains.domain import in_world
    from cgtorch.graphs import load_skill
    from cgtorch.runs.chosen import chosen_skill
    from cgtorch.tabletop.domain import Tabletop
    from cgtorch.tabletop.viewer.timeline import Candidate

    chosen = chosen_skill(path, name, actions, scenarios)
    domain, run, skills = chosen.domain, chosen.run, {}
    if world is not None:
        domain = in_world(domain, world)
    assert isinstance(domain, Tabletop)  # noqa: S101  it is about no other
    if run is not None:
        files = (run.folder / name / "skill.json" for name in run.stages)
        made = (load_skill(path, run.actions) for path in files)
        skills = {skill.name: skill for skill in made}
    skills |= {chosen.skill.name: chosen.skill}
    return chosen, {n: Candidate(s, domain) for n, s in skills.items()}


main = partial(common.run_program, command)

if __name__ == "__main__":
    main()
