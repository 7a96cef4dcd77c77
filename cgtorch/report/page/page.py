"""The page: what a run's folder holds, put into the template."""

import shlex
from collections.abc import Sequence
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from matplotlib import rc_context

import cgtorch
from cgtorch.errors import printable
from cgtorch.experiments.run import versions
from cgtorch.experiments.settings import RunSettings
from cgtorch.experiments.stages import PERIMETER, STAGES
from cgtorch.report.estimate import as_time
from cgtorch.report.page.contents import Contents, Stage, read_contents
from cgtorch.report.page.course import course_of
from cgtorch.report.page.models import model_quality
from cgtorch.report.page.paper import (
    AROUND,
    AROUND_SUCCEEDED,
    AROUND_TRIED,
    EXPERIMENTS,
)
from cgtorch.report.page.plots import draw_fitness, draw_rates, draw_success
from cgtorch.report.page.reproduce import OLD_ENGINE, changes_of, training_commands
from cgtorch.report.page.shares import counted, interval, share, share_of
from cgtorch.report.page.stages import stage_sections
from cgtorch.report.page.vector import STYLE, inline_svg

DASH = "–"


def report_page(folder: Path, trusted: Sequence[str] = ()) -> bytes:
    """A run as one HTML page that needs nothing else: no script, no other file, no network.

    Args:
        folder: of the run, which may be unfinished.
        trusted: actions of its own that may be imported, as in `cgtorch.experiments.run.open_run`.

    Returns:
        The page as UTF-8; of the same run always the same bytes.

    Raises:
        CgtorchError: there is no run, or a file of it is damaged.
    """
    contents = read_contents(folder, trusted)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cgtorch.report.page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )
    style = (files("cgtorch.report.page") / "templates" / "page.css").read_text()
    page = environment.get_template("page.html").render(
        **_context(contents),
        style=Markup(style),  # noqa: S704  our own file
    )
    return page.encode()


def _context(contents: Contents) -> dict[str, Any]:
    run, about = contents.run, contents.about
    stages = stage_sections(contents)
    known = {"engine": OLD_ENGINE, **about}
    made_with = [(name, str(known.get(name, DASH))) for name in versions()]
    return {
        "name": run.folder.resolve().name,
        "made_with": made_with,
        "origin": [
            ("Robot", run.robot.description.name),
            *((f"Made with {name}", version) for name, version in made_with),
            ("This page by cgtorch", cgtorch.__version__),
        ],
        "version": cgtorch.__version__,
        "robot": run.robot.description.name,
        "stages": stages,
        "rounds": len(run.rounds),
        "done": [stage for stage in stages if stage.reached],
        "paper": run.settings.scenarios == PERIMETER,
        "cards": _cards(contents),
        "results": [_row(stage) for stage in contents.stages],
        "around": {"succeeded": AROUND_SUCCEEDED, "tried": AROUND_TRIED, "text": AROUND}
        | {"theirs": share(AROUND_SUCCEEDED, AROUND_TRIED), "ours": _around(contents)},
        "missing": _missing(contents),
        "success": _success(contents),
        **_evolution(contents),
        "models": model_quality(contents),
        "settings": _settings(run.settings),
        "changes": changes_of(about),
        "training": training_commands(run, about, contents.summary),
        "using": _using(contents),
    }


def _cards(contents: Contents) -> list[tuple[str, str, str]]:
    """The few numbers that matter most: name, value, and a word beside it."""
    if not contents.stages:
        return []
    results = [stage.result for stage in contents.stages]
    last = results[-1]
    beside = f"the paper: {AROUND_SUCCEEDED} of {AROUND_TRIED}"
    around = last["perimeter"]
    return [
        ("Finished", last["stage"], f"{len(results)} stage{'s' if len(results) != 1 else ''}"),
        (
            f"Reached, {around['placement']}",
            f"{around['succeeded']} of {around['tried']}",
            beside if around["placement"] == PERIMETER else interval(around),
        ),
        ("Forgotten", f"{sum(r['w_lost'] for r in results)}", "of all solved before (eq. 1a)"),
        ("Generations", f"{sum(r['generations'] for r in results):,}", "in the models"),
        ("Improving", as_time(sum(r["seconds"] for r in results)), "in all stages"),
    ]


def _row(stage: Stage) -> tuple[str, ...]:
    """A line of the table of results."""
    r, published = stage.result, EXPERIMENTS.get(stage.name)
    return (
        stage.name,
        r["edge"],
        f"{r['targets_succeeded']} of {r['targets']}",
        f"{published.succeeded} of {published.tried}" if published else DASH,
        f"{r['w_size'] - r['w_lost']} of {r['w_size']}",
        counted(r["fresh"]),
        counted(r["perimeter"]),
        f"{r['nodes']}",
        f"{r['depth']}",
        f"{r['generations']}",
        as_time(r["seconds"]),
    )


def _around(contents: Contents) -> tuple[str, str] | None:
    """The stage that was tried all around last, and how it did."""
    tested = [s for s in contents.stages if s.result["perimeter"]["placement"] == PERIMETER]
    if not tested:
        return None
    return tested[-1].name, share_of(tested[-1].result["perimeter"])


def _missing(contents: Contents) -> list[str]:
    """What an unfinished or thinned out run has not."""
    run, said = contents.run, []
    if not contents.stages:
        said.append("No stage is finished yet, so there is no skill to show.")
    elif contents.run.settings.scenarios == PERIMETER and not run.rounds:
        lacking = [name for name in STAGES if name not in run.stages]
        if lacking:
            said.append(f"The run has not made {', '.join(lacking)}.")
    said += [
        f"{begun.name} has begun and is not finished; its journal knows "
        f"{begun.generations} generation{'s' if begun.generations != 1 else ''}."
        for begun in contents.begun
    ]
    if not contents.told.scalars:
        said.append("There are no TensorBoard files, so no course of the evolution.")
    if contents.fitted is None:
        said.append("There are no models Γ and C in the folder, so nothing of their fits.")
    return said


def _success(contents: Contents) -> Markup:
    stages = contents.stages
    if not stages:
        return Markup("")
    shares, others = (
        [(s.name, s.result[kind]["succeeded"], s.result[kind]["tried"]) for s in stages]
        for kind in ("fresh", "perimeter")
    )
    paper = contents.run.settings.scenarios == PERIMETER
    words = ("fresh placements of the stage", "placements all around")
    if contents.run.rounds:
        words = ("fresh placements", "those that decide, if it came to that")
    with rc_context(STYLE):
        figure = draw_success(shares, others, *words, paper)
    return inline_svg(figure, "success", "Share of placements reached, by stage")


def _evolution(contents: Contents) -> dict[str, Any]:
    course = course_of(contents)
    pictures = {"fitness": Markup(""), "rates": Markup(""), "logged": 0}
    if course is None:
        return pictures
    with rc_context(STYLE):
        fitness = draw_fitness(contents.told, course)
        rates = draw_rates(contents.told, course)
    pictures["fitness"] = inline_svg(
        fitness, "fitness", "Fitness, share without fitness, and nodes over generations"
    )
    if rates is not None:
        pictures["rates"] = inline_svg(rates, "rates", "Self-adapted rates over generations")
    return {**pictures, "logged": len(course.steps)}


def _settings(settings: RunSettings) -> list[tuple[str, str, str, str]]:
    """Name, value, default where it is another, and what it means."""
    rows = []
    for f in fields(RunSettings):
        value = getattr(settings, f.name)
        shown, usual = map(_text, (value, f.default))
        rows.append((f.name, shown, "" if shown == usual else usual, f.metadata["help"]))
    return rows


def _text(value: object) -> str:
    return (", ".join(value) or "none") if isinstance(value, tuple) else str(value)


def _using(contents: Contents) -> list[str]:
    """Commands for the run as it is."""
    name = shlex.quote(contents.run.folder.resolve().name)
    actions = [f"--actions {shlex.quote(a)}" for a in contents.run.settings.actions if ":" in a]
    rest = "".join(f" {words}" for words in actions)
    scenarios = contents.run.settings.scenarios
    commands = []
    if contents.stages:
        commands = [
            f"cgtorch-evaluate {name} --scenarios {scenarios} --count 1000{rest}",
            f"cgtorch-export {name} --format module --output skill.pt2{rest}",
        ]
    return [
        *commands,
        f"tensorboard --logdir {name}",
        f"cgtorch-report {name} --output report.html{rest}",
    ]
