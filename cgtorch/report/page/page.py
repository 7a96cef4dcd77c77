"""The page: what a run's folder holds, put into the template."""

import shlex
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from matplotlib import rc_context

from cgtorch.domains.domain import Domain
from cgtorch.domains.registry import is_code
from cgtorch.ground.errors import printable
from cgtorch.ground.version import __version__
from cgtorch.report.estimate import as_time
from cgtorch.report.html import STYLE, inline_svg
from cgtorch.report.page.contents import Contents, Stage, read_contents
from cgtorch.report.page.course import course_of
from cgtorch.report.page.models import model_quality
from cgtorch.report.page.plots import draw_fitness, draw_rates, draw_success
from cgtorch.report.page.reproduce import changes_of, training_commands
from cgtorch.report.page.shares import counted, interval, share, share_of
from cgtorch.report.page.stages import stage_sections
from cgtorch.runs.run import Run, versions
from cgtorch.runs.settings import all_fields, defaults_of

DASH = "–"


def report_page(folder: Path, trusted: Sequence[str] = (), domain: str | None = None) -> bytes:
    """A run as one HTML page that needs nothing else: no script, no other file, no network.

    Args:
        folder: of the run, which may be unfinished.
        trusted: actions of its own that may be imported, as in `cgtorch.runs.run.open_run`.
        domain: likewise.

    Returns:
        The page as UTF-8; of the same run always the same bytes.

    Raises:
        CgtorchError: there is no run, or a file of it is damaged.
    """
    contents = read_contents(folder, trusted, domain)
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
    run, about, domain = contents.run, contents.about, contents.run.domain
    stages = stage_sections(contents)
    names = {**versions(), **domain.made_with()}
    made_with = [(name, str(about.get(name, DASH))) for name in names]
    return {
        "name": run.folder.resolve().name,
        "made_with": made_with,
        "origin": [
            ("Domain", run.settings.domain),
            *domain.about(),
            *((f"Made with {name}", version) for name, version in made_with),
            ("This page by cgtorch", __version__),
        ],
        "version": __version__,
        "about": ", ".join(f"{name.lower()} {value}" for name, value in domain.about()),
        "stages": stages,
        "rounds": len(run.rounds),
        "done": [stage for stage in stages if stage.reached],
        "solved": domain.solved[0],
        "solved_many": domain.solved[1],
        "publisher": domain.publisher,
        "beside": bool(domain.published) and run.kind == domain.usual_kind,
        "cards": _cards(contents),
        "published": bool(domain.published),
        "results": [_row(stage, domain) for stage in contents.stages],
        "overall": domain.published.get(""),
        "overall_theirs": _theirs(domain),
        "overall_ours": _overall(contents),
        "missing": _missing(contents),
        "success": _success(contents),
        **_evolution(contents),
        "learns": run.learns,
        "models": model_quality(contents),
        "settings": _settings(run),
        "changes": changes_of(about),
        "training": training_commands(run, about, contents.summary),
        "using": _using(contents),
    }


def _theirs(domain: Domain[Any]) -> str:
    published = domain.published.get("")
    return "" if published is None else share(published.succeeded, published.tried)


def _cards(contents: Contents) -> list[tuple[str, str, str]]:
    """The few numbers that matter most: name, value, and a word beside it."""
    if not contents.stages:
        return []
    domain, results = contents.run.domain, [stage.result for stage in contents.stages]
    last, published = results[-1], domain.published.get("")
    tested = last["overall"]
    beside = interval(tested)
    if published is not None and tested["scenarios"] == domain.usual_kind:
        beside = f"{domain.publisher}: {published.succeeded} of {published.tried}"
    mean = tested.get("mean_return")
    return [
        ("Finished", last["stage"], f"{len(results)} stage{'s' if len(results) != 1 else ''}"),
        (
            f"{domain.solved[0].capitalize()}, {tested['scenarios']}",
            f"{tested['succeeded']} of {tested['tried']}",
            beside,
        ),
        *([("Mean return", f"{mean:.5g}", "of fresh episodes")] if mean is not None else []),
        ("Forgotten", f"{sum(r['w_lost'] for r in results)}", "of all solved before (eq. 1a)"),
        ("Generations", f"{sum(r['generations'] for r in results):,}", "of all evolutions"),
        ("Improving", as_time(sum(r["seconds"] for r in results)), "in all stages"),
    ]


def _row(stage: Stage, domain: Domain[Any]) -> tuple[str, ...]:
    """A line of the table of results."""
    r, published = stage.result, domain.published.get(stage.name)
    theirs = f"{published.succeeded} of {published.tried}" if published else DASH
    tests = f"{r['targets_succeeded']} of {r['targets']}" if r["targets"] else DASH
    return (
        stage.name,
        r["scenarios"],
        tests,
        *([theirs] if domain.published else []),
        f"{r['w_size'] - r['w_lost']} of {r['w_size']}",
        counted(r["fresh"]),
        counted(r["overall"]),
        f"{r['nodes']}",
        f"{r['depth']}",
        f"{r['generations']}",
        as_time(r["seconds"]),
    )


def _overall(contents: Contents) -> tuple[str, str] | None:
    """The stage that was tried on scenarios of the usual kind last, and how it did."""
    usual = contents.run.domain.usual_kind
    tested = [s for s in contents.stages if s.result["overall"]["scenarios"] == usual]
    if not tested:
        return None
    return tested[-1].name, share_of(tested[-1].result["overall"])


def _missing(contents: Contents) -> list[str]:
    """What an unfinished or thinned out run has not."""
    run, said = contents.run, []
    if not contents.stages:
        said.append("No stage is finished yet, so there is no skill to show.")
    elif run.kind == run.domain.usual_kind and not run.rounds:
        lacking = [name for name in run.domain.stages if name not in run.stages]
        if lacking:
            said.append(f"The run has not made {', '.join(lacking)}.")
    said += [
        f"{begun.name} has begun and is not finished; its journal knows "
        f"{begun.generations} generation{'s' if begun.generations != 1 else ''}."
        for begun in contents.begun
    ]
    if not contents.told.scalars:
        said.append("There are no TensorBoard files, so no course of the evolution.")
    if contents.fitted is None and run.learns:
        said.append("There are no models Γ and C in the folder, so nothing of their fits.")
    return said


def _success(contents: Contents) -> Markup:
    stages, domain = contents.stages, contents.run.domain
    if not stages:
        return Markup("")
    shares, others = (
        [(s.name, s.result[kind]["succeeded"], s.result[kind]["tried"]) for s in stages]
        for kind in ("fresh", "overall")
    )
    theirs = domain.published.get("") if contents.run.kind == domain.usual_kind else None
    line = None if theirs is None else (domain.publisher, theirs.succeeded / theirs.tried)
    words = ("fresh scenarios of the stage", "all kinds of scenarios")
    if contents.run.rounds:
        words = ("fresh scenarios", "those that decide, if it came to that")
    with rc_context(STYLE):
        figure = draw_success(shares, others, *words, line)
    return inline_svg(figure, "success", "Share of scenarios solved, by stage")


def _evolution(contents: Contents) -> dict[str, Any]:
    course = course_of(contents)
    pictures = {"fitness": Markup(""), "rates": Markup(""), "logged": 0}
    if course is None:
        return pictures
    with rc_context(STYLE):
        fitness = draw_fitness(contents.told, course, contents.run.domain.rewarded)
        rates = draw_rates(contents.told, course)
    pictures["fitness"] = inline_svg(
        fitness, "fitness", "Fitness, share that is worth nothing, and nodes over generations"
    )
    if rates is not None:
        pictures["rates"] = inline_svg(rates, "rates", "Self-adapted rates over generations")
    return {**pictures, "logged": len(course.steps)}


def _settings(run: Run) -> list[tuple[str, str, str, str]]:
    """Name, value, default where it is another, and what it means."""
    rows, values = [], run.all_settings()
    usual = defaults_of(type(run.domain.settings))
    for f in all_fields(type(run.domain.settings)):
        shown, default = map(_text, (values[f.name], usual.get(f.name, f.default)))
        rows.append((f.name, shown, "" if shown == default else default, f.metadata["help"]))
    return rows


def _text(value: object) -> str:
    return (", ".join(value) or "none") if isinstance(value, tuple | list) else str(value)


def _using(contents: Contents) -> list[str]:
    """Commands for the run as it is."""
    name = shlex.quote(contents.run.folder.resolve().name)
    actions = [f"--actions {shlex.quote(a)}" for a in contents.run.settings.actions if ":" in a]
    spec = contents.run.settings.domain
    domain = [f"--domain {shlex.quote(spec)}"] if is_code(spec) else []
    rest = "".join(f" {words}" for words in [*domain, *actions])
    scenarios, commands = contents.run.kind, []
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
