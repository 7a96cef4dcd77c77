"""A run as one HTML page, made from the run's folder alone: its contents, in a template."""

from base64 import b64encode
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from markupsafe import Markup
from matplotlib import rc_context

from cgtorch import __version__
from cgtorch.domains.domain import rewarded
from cgtorch.domains.failures import Explained
from cgtorch.domains.film import animated
from cgtorch.graphs import load_skill
from cgtorch.ground.asked import NAMES as ASKED
from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.ground.files import as_word, place_of, read_json
from cgtorch.ground.statistics import wilson
from cgtorch.report.failure_section import failure_section
from cgtorch.report.html import STYLE, inline_svg, templates
from cgtorch.report.messages import as_time
from cgtorch.report.plots import draw_fitness, draw_rates, draw_success
from cgtorch.report.reproduce import changes_of, training_commands
from cgtorch.report.sections import Stage, model_quality, stage_sections
from cgtorch.runs.chosen import own_code
from cgtorch.runs.journal import FOLDER as JOURNAL
from cgtorch.runs.journal import FileJournal
from cgtorch.runs.log import Row, read_log, results_in
from cgtorch.runs.settings import all_fields, defaults_of, help_of
from cgtorch.runs.storage import load_scenarios
from cgtorch.runs.stored_run import AUTO, StoredRun, versions

PACKAGE = "cgtorch.report"
FILMED, MOST_FILMED = 240, 1_000_000  # px, and bytes, of the film


@dataclass(frozen=True)
class Contents:
    """Everything that the page shows; `begun` are unfinished stages, and their generations."""

    run: StoredRun
    about: dict[str, Any]
    stages: tuple[Stage, ...]
    begun: tuple[tuple[str, int], ...]
    log: list[Row]

    def rows(self, event: str) -> list[Row]:
        """The rows of the log of one kind."""
        return [row for row in self.log if row["event"] == event]


def report_page(run: StoredRun, why: Explained | None = None) -> bytes:
    """A run as one HTML page that needs nothing else: no script, no other file, no network.

    With `why`, it has a section on where the last skill fails. It is UTF-8. The same run under the
    same name, even an unfinished one, always gives the same bytes. CgtorchError if a file of the
    run is damaged.
    """
    contents = read_contents(run)
    style = (files(PACKAGE) / "templates" / "page.css").read_text()
    template = templates(PACKAGE).get_template("page.html")
    with rc_context(STYLE):
        context = _context(contents)
        context["failures"] = why and failure_section(why, run.domain, run.pictures)
    return template.render(context, style=Markup(style)).encode()  # noqa: S704  our own file


def read_contents(run: StoredRun) -> Contents:
    """Read all files of a run; nothing is tried or computed again."""
    about, log = read_json(run.folder / "run.json"), read_log(run.folder)
    if not isinstance(about, dict):
        raise RunError(f"{str(run.folder / 'run.json')!r} holds no object; restore the file")
    accepted = {row["stage"]: row for row in log if row["event"] == "accepted"}
    stages, journals = [], sorted((run.folder / JOURNAL).glob("*"))
    for result in results_in(log, run.stages, run.folder):
        folder = run.folder / result["stage"]
        skill = load_skill(folder / "skill.json", run.actions)
        known = load_scenarios(folder / "scenarios.json", run.like())
        for test in ("fresh", "overall"):  # which a robot is not asked for
            result[test] = result.get(test) or {"scenarios": run.kind, "tried": 0, "succeeded": 0}
        about_it = result["stage"], result, skill, *known, accepted.get(result["stage"])
        stages.append(Stage(*about_it))
    begun = [path for path in journals if path.is_dir() and path.name not in run.stages]
    counts = tuple((path.name, FileJournal(path).generations) for path in begun)
    return Contents(run, about, tuple(stages), counts, log)


def _context(contents: Contents) -> dict[str, Any]:
    run, domain = contents.run, contents.run.domain
    film, undrawn = _film(contents)
    names = {**versions(), **run.files.made_with()}
    return {
        "name": run.folder.resolve().name,
        "run": run,
        "domain": domain,
        "pictures": run.pictures,
        "made_with": [(name, str(contents.about.get(name, "–"))) for name in names],
        "version": __version__,
        "about": run.pictures.about(),
        "stages": stage_sections(run, contents.stages),
        "results": [stage.result for stage in contents.stages],
        "by_mean": any(stage.result.get("mean_holds") is not None for stage in contents.stages),
        "asked": _asked_by_phase(contents),
        "usual": run.kind == domain.kinds[0],
        "film": film,
        "missing": [*_missing(contents), *undrawn],
        "success": _success(contents),
        **_evolution(contents),
        "models": model_quality(contents.rows("models")),
        "settings": _settings(run),
        "changes": changes_of(contents.log),
        "training": training_commands(run, contents.about, contents.log),
        "place": place_of(run.folder).as_posix(),
        "using": _using(contents),
        "own_code": own_code(contents.run),
        "time": as_time,
        "interval": _interval,
    }


def _interval(succeeded: int, tried: int) -> str:
    """The 95 % confidence interval of a share."""
    low, high = wilson(succeeded, tried, 0.95)
    return f"95 %: {low:.1%} to {high:.1%}"


def _film(contents: Contents) -> tuple[str, list[str]]:
    """A moving picture of the last skill on something that it has solved, as a URL; "" if none.

    Also, why it could not be drawn.
    """
    solved = [stage for stage in contents.stages if len(stage.solved)]
    if not solved or contents.run.settings.driver:
        return "", []
    skill, scenarios = solved[-1].skill, solved[-1].solved
    try:
        film = contents.run.pictures.film(skill, scenarios[len(scenarios) - 1 :], FILMED)
        data = animated([film], "webp") if film else b""
    except CgtorchError as e:
        return "", [f"There is no film of {skill.name}: {e}."]
    if len(data) > MOST_FILMED:
        return "", [f"The film of {skill.name} is too large for a page; cgtorch-view makes it."]
    return "data:image/webp;base64," + b64encode(data).decode() if data else "", []


def _asked_by_phase(contents: Contents) -> list[tuple[Any, ...]]:
    """What was asked: phase, motions, tests, looks and episodes, and their sums.

    In worlds of low-level steps, also those requested, and those that were simulated. Where nothing
    is counted, there is no row.
    """
    spent = contents.stages[-1].result["asked"] if contents.stages else {}
    if not spent:
        return []
    rows = [(phase, *(asked[name] for name in ASKED)) for phase, asked in spent.items()]
    sums = ("all", *(sum(row[i] for row in rows) for i in range(1, 1 + len(ASKED))))
    columns = len(sums) if sums[-1] else len(sums) - 2
    return [row[:columns] for row in (*rows, sums)]


def _missing(contents: Contents) -> list[str]:
    """The parts that an unfinished or incomplete run lacks."""
    run, said = contents.run, []
    if not contents.stages:
        said.append("No stage is finished yet, so there is no skill to show.")
    elif run.kind == run.domain.kinds[0] and not run.rounds:
        lacking = [name for name in _asked(contents) if name not in run.stages]
        if lacking:
            made = ", ".join(run.stages)
            said.append(f"Finished stages: {made}. Not finished: {', '.join(lacking)}.")
    said += [
        f"{name} has begun and is not finished; its journal knows "
        f"{generations} generation{'s' if generations != 1 else ''}."
        for name, generations in contents.begun
    ]
    if not contents.rows("generation"):
        said.append("The log has no generations, so the page has no plots of the evolution.")
    if run.learns and not contents.rows("models"):
        said.append("The log has nothing of Γ and C, so the page has no model reports.")
    return said


def _asked(contents: Contents) -> list[str]:
    """The stages that the run was last asked for, which are all if that is not known."""
    goal, stages = contents.about.get("goes_on_to"), list(contents.run.domain.stages)
    last = goal.get("stage") if isinstance(goal, dict) else None
    if last == AUTO:
        return []
    return stages[: stages.index(last) + 1] if last in stages else stages


def _success(contents: Contents) -> Markup:
    stages, run = contents.stages, contents.run
    if not any(s.result[kind]["tried"] for s in stages for kind in ("fresh", "overall")):
        return Markup("")
    shares, others = (
        [(s.name, s.result[kind]["succeeded"], s.result[kind]["tried"]) for s in stages]
        for kind in ("fresh", "overall")
    )
    theirs = run.pictures.published.get("") if run.kind == run.domain.kinds[0] else None
    line = None if theirs is None else (run.pictures.publisher, theirs.succeeded / theirs.tried)
    words = ("fresh scenarios of the stage", "all kinds of scenarios")
    if run.rounds:
        words = ("fresh scenarios", "the final test, if there was one")
    figure = draw_success(shares, others, *words, line)
    return inline_svg(figure, "success", "Share of scenarios solved, by stage")


def _evolution(contents: Contents) -> dict[str, Any]:
    rows, run = contents.rows("generation"), contents.run
    if not rows:
        return {"fitness": ""}
    fitness = draw_fitness(rows, run.stages, rewarded(run.domain))
    rates = draw_rates(rows, run.stages)
    label = "Fitness, share of unsolved individuals, and nodes over generations"
    return {
        "fitness": inline_svg(fitness, "fitness", label),
        "rates": rates and inline_svg(rates, "rates", "Self-adapted rates over generations"),
        "logged": len(rows),
    }


def _settings(run: StoredRun) -> list[tuple[str, str, str, str]]:
    """Name, value, default if it differs, and meaning of each setting."""
    rows, values = [], run.all_settings()
    usual = defaults_of(type(run.domain.settings))
    for f in all_fields(type(run.domain.settings)):
        shown, default = map(_text, (values[f.name], usual.get(f.name, f.default)))
        about = help_of(f, run.settings.domain, run.domain.kinds)
        rows.append((f.name, shown, "" if shown == default else default, about))
    return rows


def _text(value: object) -> str:
    return (", ".join(value) or "none") if isinstance(value, tuple | list) else str(value)


def _using(contents: Contents) -> list[str]:
    """Commands that use the run."""
    name, rest = as_word(place_of(contents.run.folder)), own_code(contents.run)
    commands = [
        f"cgtorch-evaluate {name} --scenarios {contents.run.kind} --count 1000{rest}",
        f"cgtorch-export {name} --format state-machine --output skill.py{rest}",
    ]
    return [
        *(commands if contents.stages else []),
        f"tensorboard --logdir {name}",
        f"cgtorch-report {name} --output report.html{rest}",
    ]
