"""`cgtorch-evaluate`: try a skill in the world on fresh scenarios."""

import json
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cgtorch.commands import common, outputs
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.replacing import WHY, check_output, check_outputs
from cgtorch.ground.statistics import wilson
from cgtorch.runs.settings import MOST_TRIED

if TYPE_CHECKING:
    from cgtorch.domains.domain import Domain
    from cgtorch.domains.failures import Failures
    from cgtorch.runs.chosen import Chosen
    from cgtorch.training.evaluate import Score

PICTURED = 24
EXAMPLES = """\b
Examples:
  cgtorch-evaluate runs/reference
  cgtorch-evaluate runs/seed-0/S2 --scenarios right --count 100 --seed 3
  cgtorch-evaluate runs/reference --scenarios general --picture scenes.png
  cgtorch-evaluate runs/push --failures why
  cgtorch-evaluate runs/auto --skill auto-1
  cgtorch-evaluate skill.json --count 1000 --json
  cgtorch-evaluate runs/reference --world mujoco --count 200
"""


@common.command("cgtorch-evaluate", EXAMPLES, short_help="Try a skill on fresh scenarios.")
@common.run_or_skill
@common.scenario_options(
    "The kind of scenarios. The tabletop has near, left, right, far and perimeter (the paper's "
    "table), general (any table, from any side) and general-clutter (half of them with a box in "
    "the way). Another domain has its own kinds.  [the run's; a skill file: the domain's usual]",
    count="Number of scenarios.",
    seed="Seed of the scenarios and of their noise.",
    most=MOST_TRIED,
)
@common.skill_option
@common.domain_option
@common.world_option
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help=f"Draw the first {PICTURED} scenarios into this PNG file, if the domain draws any.",
)
@click.option(
    "--failures",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write why the skill fails into this folder: each kind of failure once, with its "
    "causes, its way through the graph, what Γ and C say, and a film where the domain can draw, "
    "and what to change.",
)
@outputs.force_option
def command(path: Path, count: int, seed: int, as_json: bool, quiet: bool, **rest: Any) -> None:
    """Try a skill in the world on fresh scenarios and print succeeded / tried.

    For a run, two more shares are printed: how often the skill succeeded where the run's models
    predicted success, and how often it solved W under other noise when it was accepted.

    RUN_OR_SKILL is the folder of a run (its last skill is taken), the folder of a stage in it, or
    a skill file. A skill file is tried in its domain's default world; for the tabletop this has
    the built-in PR2.
    """
    if rest["picture"]:
        check_output(rest["picture"], rest["force"], path, "--picture")
        if rest["picture"].suffix.lower() != ".png":
            raise SettingsError(
                f"--picture is {str(rest['picture'])!r}, and a PNG file is written; give a name "
                "that ends in .png"
            )
    if rest["failures"]:
        check_outputs(rest["failures"], WHY, rest["force"], path, "--failures")
        common.draw_without_display()
    with common.importing():
        import torch

        from cgtorch import native
        from cgtorch.domains.domain import in_world, other_measures
        from cgtorch.ground.distributed import cores
        from cgtorch.runs.chosen import chosen_skill
        from cgtorch.training.evaluate import evaluate_skill

    torch.set_num_threads(1)
    native.use_threads(cores())  # for worlds that take long, which share out work to processes
    which = rest["name"], rest["actions"], rest["scenarios"], rest["domain"]
    with common.waiting(f"loading {path}", quiet):
        chosen = chosen_skill(path, *which)
    skill, domain, kind = chosen.skill, chosen.domain, chosen.kind
    if rest["world"] is not None:
        domain = in_world(domain, rest["world"])

    def tried(domain: "Domain[Any]", message: str) -> "Score":
        with common.waiting(message, quiet, count) as done:
            return evaluate_skill(skill, domain, kind, count, seed, done)

    score = tried(domain, f"trying {skill.name} on {kind} scenarios")
    others = {
        name: tried(other, f"trying {skill.name} again: {name}")
        for name, other in other_measures(domain).items()
    }
    if rest["picture"]:
        _draw(rest["picture"], score, chosen)
    why, told = None, ""
    if rest["failures"]:
        why, told = _explained(rest["failures"], score, chosen, domain, quiet)
    own, predicted, noise = _share(score.successes, score.tried), None, None
    if chosen.run is not None and chosen.stage is not None:
        predicted, noise = _of_run(chosen, score, seed, quiet)
    measures = {name: _share(other.successes, other.tried) for name, other in others.items()}
    if as_json:
        result = {
            "skill": skill.name,
            "scenarios": kind,
            "seed": seed,
            **own,
            "mean_return": score.mean_return,
            "predicted": predicted,
            "w_other_noise": noise,
            **({"other_measures": measures} if measures else {}),
            "rows": _rows(score, why),
        }
        click.echo(json.dumps(result))
        return
    common.say(f"{skill.name} on {kind}: {_as_text(own)}")
    for name, share in measures.items():
        common.say(f"{name}: {_as_text(share)}")
    if score.returns is not None:
        common.say(_returns_as_text(score, domain.target_return))
    if predicted is not None:
        held = (
            f", of which {predicted['succeeded']} succeeded in the world, {_confidence(predicted)}"
            if predicted["tried"]
            else ""
        )
        common.say(
            f"the models predicted robust success on {predicted['tried']} of {score.tried}{held}"
        )
    if noise is not None:
        common.say(f"W under other noise, when it was accepted: {_as_text(noise)}")
    if why is not None:
        for line in (why.blame, *(advice.text for advice in why.advice), told):
            common.say(line)


def _rows(score: "Score", why: "Failures | None") -> list[dict[str, Any]]:
    """A row for each scenario, in their order; a return that is not finite is None.

    Where failures are explained, a row has the number of its kind of failure, from 1.
    """
    returns = [None] * score.tried if score.returns is None else score.returns.tolist()
    rows: list[dict[str, Any]] = [
        {"succeeded": good, "return": value if value is not None and isfinite(value) else None}
        for good, value in zip(score.succeeded.tolist(), returns, strict=True)
    ]
    if why is not None:
        rows = [{**row, "failure": None} for row in rows]
        for number, kind in enumerate(why.kinds, 1):
            for scenario in kind.scenarios:
                rows[scenario]["failure"] = number
    return rows


def _explained(
    folder: Path, score: "Score", chosen: "Chosen", domain: "Domain[Any]", quiet: bool
) -> "tuple[Failures, str]":
    """Why the skill fails, with what the models of its stage say; it is written, and told where."""
    from cgtorch.report.failure_files import write_failures
    from cgtorch.training.explained import background_of
    from cgtorch.training.failures import Background, failures_of

    run, stage = chosen.run, chosen.stage
    known = Background() if run is None or stage is None else background_of(run, stage)
    with common.waiting(f"looking at failures of {chosen.skill.name}", quiet):
        found = failures_of(chosen.skill, domain, score, known)
        paths = write_failures(folder, found, chosen.skill, domain, score.scenarios)
    return found, f"kinds of failure: {len(found.kinds)}, in {', '.join(map(str, paths))}"


def _of_run(
    chosen: "Chosen", score: "Score", seed: int, quiet: bool
) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    """The shares of predicted successes, and of W under other noise; None without models, W."""
    from cgtorch.runs.log import read_log
    from cgtorch.runs.storage import stage_knowledge
    from cgtorch.training.evaluate import robust_successes

    run, stage, skill, kept = chosen.run, chosen.stage, chosen.skill, None
    assert run is not None and stage is not None  # noqa: S101, PT018
    if (knowledge := stage_knowledge(run, stage)) is not None:
        with common.waiting(f"predicting robust successes of {skill.name}", quiet):
            kept = robust_successes(score, skill, knowledge, run.models, seed)
    accepted = (row for row in read_log(run.folder) if row["event"] == "accepted")
    met = {row["skill"]: row["w_other_noise"] for row in accepted}.get(skill.name)
    predicted = None if kept is None else _share(kept.successes, kept.tried)
    return predicted, met and _share(met["succeeded"], met["tried"])


def _returns_as_text(score: "Score", target: float) -> str:
    """The mean return and its range, or the number of unfinished episodes."""
    returns = [] if score.returns is None else score.returns.tolist()
    finite = [r for r in returns if isfinite(r)]
    if len(finite) < score.tried:
        return f"{score.tried - len(finite)} of {score.tried} episodes were not finished"
    return (
        f"mean return {score.mean_return:.5g} (from {min(finite):.5g} to {max(finite):.5g}), "
        f"where {target:.5g} counts as solved"
    )


def _share(succeeded: int, tried: int) -> dict[str, Any]:
    """A share with its interval, for programs."""
    rate, interval = succeeded / max(1, tried), list(wilson(succeeded, tried, 0.95))
    return {"tried": tried, "succeeded": succeeded, "rate": rate, "interval": interval}


def _as_text(share: dict[str, Any]) -> str:
    """A share with its interval, as text."""
    return f"{share['succeeded']} / {share['tried']} succeeded, {_confidence(share)}"


def _confidence(share: dict[str, Any]) -> str:
    low, high = share["interval"]
    return f"{share['rate']:.1%} (95 % confidence {low:.1%} to {high:.1%})"


def _draw(path: Path, score: "Score", chosen: "Chosen") -> None:
    """Draw the first scenarios and their results into a PNG file."""
    import io

    from cgtorch.ground.files import write_bytes

    scenarios, succeeded = score.scenarios[:PICTURED], score.succeeded[:PICTURED]
    nothing = succeeded.new_zeros(len(succeeded))
    pictures = chosen.domain.pictures(chosen.domain)
    figure = pictures.scenarios(scenarios, succeeded, nothing, chosen.skill.name)
    if figure is None:
        raise SettingsError(
            f"{type(chosen.domain).__name__} cannot draw its scenarios; leave --picture out"
        )
    image = io.BytesIO()
    figure.savefig(image)
    write_bytes(path, image.getvalue())


main = partial(common.run_program, command)

if __name__ == "__main__":
    main()
