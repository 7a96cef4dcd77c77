"""What the page says of each stage, beside what others report."""

from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from cgtorch.domains.domain import Published
from cgtorch.report.estimate import as_time
from cgtorch.report.page.contents import Contents, Stage
from cgtorch.report.page.pictures import Panel, Picture, graph_picture, map_picture
from cgtorch.report.page.shares import counted, share_of


@dataclass(frozen=True)
class StageSection:
    """What the page says of a stage or round.

    Attributes:
        name: of the stage.
        scenarios: the kind that it is about.
        published: what others report; None if nobody has such a stage.
        drawing: of what it is about; empty if the domain has none.
        reached: "5 of 5"; None if the stage is not made.
        what: was reached.
        facts: names and values.
        map: what the skill solved.
        graph: its graph.
        panels: the same as tables.
    """

    name: str
    scenarios: str
    published: Published | None
    drawing: Markup
    reached: str | None
    what: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    map: Picture | None = None
    graph: Picture | None = None
    panels: tuple[Panel, ...] = ()


def stage_sections(contents: Contents) -> list[StageSection]:
    """All of the run's, and those of its domain that it lacks, unless it goes on in rounds."""
    made, run = {stage.name: stage for stage in contents.stages}, contents.run
    domain, wanted = run.domain, list(made)
    if domain.stages and run.kind == domain.usual_kind and not run.rounds:
        wanted = list(domain.stages)
    sections = []
    for name in wanted:
        tests = domain.stages.get(name)
        drawing = Markup(domain.draw_stage(name) if tests else "")  # noqa: S704  the domain's own
        published = domain.published.get(name)
        if name not in made:
            sections.append(StageSection(name, tests or "", published, drawing, None))
            continue
        stage = made[name]
        graph, panels = graph_picture(stage)
        sections.append(
            StageSection(
                name,
                stage.result["scenarios"],
                published,
                drawing,
                *_score(stage.result, domain.solved[0], tests is not None),
                tuple(_facts(stage, run.learns)),
                map_picture(stage, domain, tests),
                graph,
                panels,
            )
        )
    return sections


def _score(result: dict[str, Any], solved: str, in_stages: bool) -> tuple[str, str]:
    """How much a stage has reached, and of what: its tests, fresh scenarios if it has none."""
    if in_stages and not result["targets"]:
        return counted(result["fresh"]), f"fresh ones {solved}"
    what = solved if in_stages else f"missed before, {solved} now"
    return f"{result['targets_succeeded']} of {result['targets']}", what


def _facts(stage: Stage, learns: bool) -> list[tuple[str, str]]:
    r = stage.result
    facts = [
        ("Fresh scenarios", _tested(r["fresh"])),
        ("All kinds together", _tested(r["overall"])),
        ("Solved before, lost now (eq. 1a)", f"{r['w_lost']} of {r['w_size']}"),
    ]
    if r["earlier_failures"]:
        earlier = f"{r['earlier_failures_succeeded']} of {r['earlier_failures']}"
        facts.append(("Earlier failures reached now", earlier))
    if (line := stage.accepted) is not None:
        facts.append(
            ("Missed before, solved now (eq. 1b)", f"{line['m_solved']} of {line['m_before']}")
        )
        if (again := line["w_other_noise"]) is not None:
            facts.append(("Solved under other noise, too", share_of(again)))
    else:
        facts.append(("New skill", f"none was accepted; {stage.skill.name} goes on"))
    return [
        *facts,
        ("Nodes, levels", f"{r['nodes']}, {r['depth']}"),
        ("Generations", f"{r['generations']:,}"),
        (f"Actions tried in the {'models' if learns else 'world'}", f"{r['transitions']:,}"),
        ("Time", _time(stage)),
    ]


def _tested(score: dict[str, Any]) -> str:
    mean = score.get("mean_return")
    more = "" if mean is None else f", mean return {mean:.5g}"
    return f"{share_of(score)} on {score['scenarios']}{more}"


def _time(stage: Stage) -> str:
    search, words = stage.result.get("search_seconds"), as_time(stage.result["seconds"])
    if isinstance(search, int | float) and 0 <= search < 1e12:
        words += f", of which search {as_time(search)}"
    return words
