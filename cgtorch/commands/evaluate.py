"""`cgtorch-evaluate`: try a skill in the world on fresh scenarios."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cgtorch.commands.command import import_from_here, importing, run_command
from cgtorch.commands.completion import SCENARIOS, one_of
from cgtorch.commands.options import (
    actions_option,
    common_options,
    epilog,
    quiet_option,
    run_or_skill,
    skill_option,
    waiting,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from cgtorch.experiments.evaluate import Score
    from cgtorch.graphs import Skill
    from cgtorch.world import Scenarios, TabletopWorld

EXAMPLES = """\b
Examples:
  cgtorch-evaluate runs/reference
  cgtorch-evaluate runs/seed-0/S2 --scenarios right --count 100 --seed 3
  cgtorch-evaluate runs/reference --scenarios general --picture scenes.png
  cgtorch-evaluate runs/auto --skill auto-1
  cgtorch-evaluate skill.json --count 1000 --json
"""


PICTURED = 24


@click.command("cgtorch-evaluate", epilog=epilog(EXAMPLES))
@run_or_skill
@click.option(
    "--scenarios",
    shell_complete=one_of(SCENARIOS),
    help="near, left, right, far or perimeter of the paper's table; general: any table, from any "
    "side; general-clutter: half of them with a box in the way.  [those of the run; perimeter for "
    "a skill file]",
)
@click.option(
    "--count",
    type=click.IntRange(1, 1_000_000),
    default=40,
    show_default=True,
    help="How many scenarios.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="Seed of the scenarios and their noise.",
)
@skill_option
@actions_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help=f"Also draw the first {PICTURED} scenes from above into this PNG file.",
)
@quiet_option
@common_options
def command(path: Path, count: int, seed: int, as_json: bool, **rest: Any) -> None:
    """Try a skill in the world on fresh scenarios and print succeeded / tried.

    Of a run it also prints how often the skill succeeded where the run's models promise it, and
    how W did under other noise when the skill was accepted.

    RUN_OR_SKILL is a run's folder, which stands for its last skill, a stage's folder in it, or a
    skill file, which is tried on the built-in PR2 with the default noise.
    """
    with importing():
        import torch

        from cgtorch.experiments.evaluate import evaluate_skill, kept_promises
        from cgtorch.experiments.ledger import read_index
        from cgtorch.experiments.storage import holds_models, load_knowledge

    torch.set_num_threads(1)
    import_from_here(rest["actions"])
    chosen = _chosen(path, rest["name"], rest["actions"], rest["scenarios"])
    skill, world_of, stage, scenarios = chosen
    quiet = rest["quiet"]
    with waiting(f"trying {skill.name} on {scenarios} scenarios", quiet, count) as done:
        score = evaluate_skill(skill, world_of, scenarios, count, seed, done)
    if rest["picture"]:
        _draw(rest["picture"], score, skill.name)
    kept, again = None, None
    if stage is not None:
        if holds_models(stage):
            knowledge = load_knowledge(stage)
            with waiting(f"asking the models what they promise of {skill.name}", quiet):
                kept = kept_promises(score, skill, knowledge, world_of(score.scenarios), seed)
        index = {line["name"]: line for line in read_index(stage.absolute().parent)}
        again = index.get(skill.name, {}).get("w_other_noise")
    if as_json:
        result = {
            "skill": skill.name,
            "scenarios": scenarios,
            "seed": seed,
            **_share(score.successes, score.tried),
            "promised": None if kept is None else _share(kept.successes, kept.tried),
            "w_other_noise": None if again is None else _share(again["succeeded"], again["tried"]),
        }
        click.echo(json.dumps(result))
        return
    click.echo(
        f"{skill.name} on {scenarios}: {score.successes} / {score.tried} succeeded, "
        f"{_as_text(score.successes, score.tried)}"
    )
    if kept is not None:
        click.echo(
            f"the models promised {kept.tried} of {score.tried}, of which {kept.successes} "
            f"succeeded in the world, {_as_text(kept.successes, kept.tried)}"
        )
    if again is not None:
        click.echo(
            f"of W, met by other noise when it was accepted, {again['succeeded']} / "
            f"{again['tried']} succeeded, {_as_text(again['succeeded'], again['tried'])}"
        )


def _chosen(
    path: Path, name: str | None, actions: tuple[str, ...], scenarios: str | None
) -> tuple["Skill", "Callable[[Scenarios], TabletopWorld]", Path | None, str]:
    """The skill to try, its world, the stage that made it, if that is known, and the scenarios."""
    from cgtorch.experiments.ledger import read_entry
    from cgtorch.experiments.run import last_skill, lone_skill, open_run, tabletop_of
    from cgtorch.experiments.settings import RunSettings
    from cgtorch.kinematics import load_robot
    from cgtorch.world import LAB_NOISE

    if name is not None:
        run = open_run(path, actions)
        skill = read_entry(path, name, run.actions).skill
        stage = path / name if (path / name).is_dir() else None
        return skill, run.world_of, stage, scenarios or run.settings.scenarios
    if path.is_file():
        kind = scenarios or RunSettings.scenarios
        percept, skill = lone_skill(path, actions, kind)
        return skill, tabletop_of(load_robot(), LAB_NOISE, percept), None, kind
    run, skill = last_skill(path, actions)
    stage = path if (path / "skill.json").is_file() else path / run.stages[-1]
    return skill, run.world_of, stage, scenarios or run.settings.scenarios


def _share(succeeded: int, tried: int) -> dict[str, Any]:
    """A counted share with its interval, for programs."""
    from cgtorch.experiments.interval import wilson

    interval = list(wilson(succeeded, tried, 0.95))
    rate = succeeded / max(1, tried)
    return {"tried": tried, "succeeded": succeeded, "rate": rate, "interval": interval}


def _as_text(succeeded: int, tried: int) -> str:
    """The same for people."""
    share = _share(succeeded, tried)
    low, high = share["interval"]
    return f"{share['rate']:.1%} (95 % confidence {low:.1%} to {high:.1%})"


def _draw(path: Path, score: "Score", name: str) -> None:
    """Write the first scenes and whether they were reached as a PNG file."""
    import io

    from cgtorch.files import write_bytes
    from cgtorch.report import draw_scenes

    image = io.BytesIO()
    some = slice(0, PICTURED)
    draw_scenes(score.scenarios[some], score.succeeded[some], title=name).savefig(image)
    write_bytes(path, image.getvalue())


def main() -> None:
    """Entry point of `cgtorch-evaluate`."""
    run_command(command)


if __name__ == "__main__":
    main()
