"""What the page says of each stage, beside what the paper says."""

from dataclasses import dataclass

from cgtorch.experiments.stages import PERIMETER, STAGES
from cgtorch.report.estimate import as_time
from cgtorch.report.page.contents import Contents, Stage
from cgtorch.report.page.paper import EXPERIMENTS
from cgtorch.report.page.paper import Experiment as Published
from cgtorch.report.page.pictures import (
    Experiment,
    Panel,
    Picture,
    experiment,
    graph_picture,
    map_picture,
)
from cgtorch.report.page.shares import share_of


@dataclass(frozen=True)
class StageSection:
    """What the page says of a stage or round.

    Attributes:
        name: of the stage.
        edge: of the table, or the scenarios, that it is about.
        published: what the paper reports; None if the paper has no such stage.
        drawing: the paper's experiment.
        reached: "5 of 5"; None if the stage is not made.
        facts: names and values.
        map: what the skill reached.
        graph: its graph.
        panels: the same as tables.
    """

    name: str
    edge: str
    published: Published | None
    drawing: Experiment | None
    reached: str | None
    facts: tuple[tuple[str, str], ...] = ()
    map: Picture | None = None
    graph: Picture | None = None
    panels: tuple[Panel, ...] = ()


def stage_sections(contents: Contents) -> list[StageSection]:
    """All of the run's, and those of the paper that it lacks, unless it is about other things."""
    made = {stage.name: stage for stage in contents.stages}
    footprint = contents.run.robot.description.footprint
    wanted = list(made)
    if contents.run.settings.scenarios == PERIMETER and not contents.run.rounds:
        wanted = list(STAGES)
    sections = []
    for name in wanted:
        edge = STAGES.get(name)
        published = EXPERIMENTS.get(name)
        drawing = None if edge is None else experiment(edge, footprint)
        if name not in made:
            sections.append(StageSection(name, edge or "", published, drawing, None))
            continue
        stage = made[name]
        graph, panels = graph_picture(stage)
        sections.append(
            StageSection(
                name,
                stage.result["edge"],
                published,
                drawing,
                f"{stage.result['targets_succeeded']} of {stage.result['targets']}",
                tuple(_facts(stage)),
                map_picture(stage, edge, footprint),
                graph,
                panels,
            )
        )
    return sections


def _facts(stage: Stage) -> list[tuple[str, str]]:
    r = stage.result
    facts = [
        ("Fresh placements reached", f"{share_of(r['fresh'])} on {r['fresh']['placement']}"),
        ("All around", f"{share_of(r['perimeter'])} on {r['perimeter']['placement']}"),
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
        ("Actions tried in the models", f"{r['transitions']:,}"),
        ("Time", _time(stage)),
    ]


def _time(stage: Stage) -> str:
    search, words = stage.result.get("search_seconds"), as_time(stage.result["seconds"])
    if isinstance(search, int | float) and 0 <= search < 1e12:
        words += f", of which search {as_time(search)}"
    return words
