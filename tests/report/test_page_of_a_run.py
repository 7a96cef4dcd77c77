"""What is on the page of a finished run, beside the files it comes from."""

import itertools
import json
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest
from lxml import html
from reaching import TABLE
from report_pages import REFERENCE, STAGES, final_text, parsed, words
from told_by_runs import logged

from cgtorch.graphs import load_skill, to_networkx
from cgtorch.graphs.clusters import clusters_of
from cgtorch.report.page import report_page
from cgtorch.runs.storage import load_knowledge, load_scenarios
from cgtorch.runs.stored_run import read_run
from cgtorch.tabletop.published import EXPERIMENTS
from cgtorch.tabletop.table_picture import MOST_MARKS

VOID = {"meta", "link", "br", "img", "hr", "input"}
RUN = read_run(REFERENCE)
RESULTS = RUN.results


def part(page: html.HtmlElement, name: str) -> html.HtmlElement:
    """The part of the page about a stage."""
    return page.get_element_by_id(f"stage-{STAGES.index(name) + 1}")


def cells(table: html.HtmlElement) -> list[list[str]]:
    return [[words(cell) for cell in row.iter("th", "td")] for row in table.iter("tr")]


def table(page: html.HtmlElement, caption: str) -> list[list[str]]:
    (found,) = [t for t in page.iter("table") if words(t.find("caption")).startswith(caption)]
    return cells(found)


def facts(element: html.HtmlElement) -> dict[str, str]:
    pairs = (dt.getparent() for dt in element.iter("dt"))
    return {words(pair.find("dt")): words(pair.find("dd")) for pair in pairs}


def parts(picture: html.HtmlElement, kind: str) -> list[str]:
    """What the artists of a kind in a picture stand for."""
    names = (element.get("data-part") for element in picture.iter())
    return [name.removeprefix(f"{kind}:") for name in names if name and name.startswith(f"{kind}:")]


class Nesting(HTMLParser):
    """Notes every tag that is not closed where it should be."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        if len(set(names)) < len(names):
            self.wrong.append(f"{tag} says twice {names}")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def test_it_is_whole_html(page_bytes: bytes) -> None:
    reader = Nesting()
    reader.feed(page_bytes.decode())
    reader.close()
    assert (reader.wrong, reader.open) == ([], [])
    assert page_bytes.startswith(b'<!DOCTYPE html>\n<html lang="en">')


def test_it_needs_nothing_else(page: html.HtmlElement, page_bytes: bytes) -> None:
    tags = {element.tag for element in page.iter() if isinstance(element.tag, str)}
    assert not tags & {"script", "link", "img", "iframe", "object", "embed", "base", "image"}
    for element in page.iter():
        for name, value in element.attrib.items():
            assert not name.startswith("on")
            if name in ("src", "href", "xlink:href", "action", "data"):
                assert value.startswith("#"), (element.tag, name, value)
    text = page_bytes.decode()
    assert set(re.findall(r"url\((.)", text)) <= {"#"}
    assert "@import" not in text
    (policy,) = page.xpath("//meta[@http-equiv='Content-Security-Policy']/@content")
    assert policy == "default-src 'none'; style-src 'unsafe-inline'"
    assert len(page_bytes) < 2**20


def test_names_are_unique_and_lead_somewhere(page: html.HtmlElement) -> None:
    names = Counter(page.xpath("//@id"))
    assert {name for name, count in names.items() if count > 1} == set()
    referred = {value[1:] for value in page.xpath("//@href")}
    for value in (*page.xpath("//@clip-path"), *page.xpath("//@style")):
        referred |= set(re.findall(r"url\(#([^)]+)\)", value))
    for value in (*page.xpath("//@aria-labelledby"),):
        referred |= set(value.split())
    assert referred - set(names) == set()
    assert {"results", "stages", "overall", "evolution", "models", "settings", "reproduce"} <= {
        link.removeprefix("#") for link in page.xpath("//nav//@href")
    }


def test_it_can_be_read_without_seeing_it(page: html.HtmlElement) -> None:
    pictures = list(page.iter("svg"))
    assert len(pictures) == 4 * 3 + 5
    for picture in pictures:
        assert picture.get("role") == "img"
        assert len(picture.get("aria-label")) > 5
    for name in STAGES:
        labels = part(page, name).xpath(".//svg/@aria-label")
        assert f"Graph of {name}: " in " ".join(labels)
    levels = [int(e.tag[1]) for e in page.iter("h1", "h2", "h3", "h4")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))
    for found in page.iter("table"):
        assert found.find("caption") is not None
        assert set(found.xpath(".//th/@scope")) == {"col", "row"}


def test_every_picture_is_words_and_lines(page: html.HtmlElement) -> None:
    """Text is text, with the colours of the page."""
    for picture in page.iter("svg"):
        assert float(picture.get("width")) > 100
        shapes = list(picture.iter("path", "use", "rect", "circle", "ellipse"))
        assert len(shapes) > 5
        styles = " ".join(picture.xpath(".//@style"))
        assert not re.search(r"(?<!, )#[0-9a-f]{6}", styles)
    assert "crossover" in words(page.get_element_by_id("evolution"))


def test_results_are_those_of_the_run(page: html.HtmlElement) -> None:
    head, *rows = table(page, "Objects reached")
    assert head[:5] == ["stage", "on", "reached", "the paper", "W kept"]
    assert len(rows) == len(RESULTS) == 4
    for row, result in zip(rows, RESULTS, strict=True):
        found = dict(zip(head, row, strict=True))
        paper = EXPERIMENTS[result["stage"]]
        assert found["stage"] == result["stage"]
        assert found["on"] == result["scenarios"]
        assert found["reached"] == f"{result['targets_succeeded']} of {result['targets']}"
        assert found["the paper"] == f"{paper.succeeded} of {paper.tried}"
        assert found["W kept"] == f"{result['w_size'] - result['w_lost']} of {result['w_size']}"
        assert found["fresh"] == f"{result['fresh']['succeeded']} of {result['fresh']['tried']}"
        overall = result["overall"]
        assert found["overall"] == f"{overall['succeeded']} of {overall['tried']}"
        assert found["generations"] == str(result["generations"])


def test_the_paper_says_the_same_here_as_in_the_final_table(page: html.HtmlElement) -> None:
    lines = [line.split() for line in final_text(RESULTS, TABLE).splitlines()[2:]]
    _, *rows = table(page, "Objects reached")
    for (name, _, _, theirs, *_), row in zip(lines[:-1], rows, strict=True):
        assert theirs == EXPERIMENTS[name].text
        assert row[3] == theirs.replace("/", " of ")
    details = [words for name in STAGES for words, _ in EXPERIMENTS[name].details]
    assert [int(words.split()[1].strip(",")) for words in details] == [*range(3, 11)]


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_stands_beside_the_paper(page: html.HtmlElement, name: str) -> None:
    published, here = EXPERIMENTS[name], part(page, name)
    paper, ours = (here.find_class(kind)[0] for kind in ("paper", "ours"))
    assert words(paper.find_class("score")[0]) == f"{published.succeeded} of 5 reached"
    (result,) = (r for r in RESULTS if r["stage"] == name)
    reached = f"{result['targets_succeeded']} of {result['targets']} reached"
    assert words(ours.find_class("score")[0]) == reached
    assert len(published.details) == 2
    for heading, text in published.details:
        assert f"{heading}. {text}" in words(paper)
    # As many objects as the paper tried, within the dashed ellipse, on the table.
    drawing = paper.find_class("schematic")[0]
    x, y, rx, ry = (float(drawing.find_class("set")[0].get(k)) for k in ("cx", "cy", "rx", "ry"))
    objects = [(float(o.get("cx")), float(o.get("cy"))) for o in drawing.find_class("object")]
    assert len(objects) == published.tried
    assert all(((a - x) / rx) ** 2 + ((b - y) / ry) ** 2 < 1 for a, b in objects)
    side = {"S0": y > 20, "S1": x < -40, "S2": x > 40, "S3": y < -20}
    assert side[name]


@pytest.mark.parametrize("name", STAGES)
def test_a_map_shows_all_that_was_tried(page: html.HtmlElement, name: str) -> None:
    solved, missed = load_scenarios(REFERENCE / name / "scenarios.json", RUN.like())
    picture = next(e for e in part(page, name).iter("svg") if "from above" in e.get("aria-label"))
    marks = {e.get("data-part"): len([*e.iter("use")]) for e in picture.iter("g")}
    assert marks["reached"] == min(len(solved), MOST_MARKS - len(missed))
    assert marks.get("missed", 0) == len(missed)
    assert marks["targets"] == 5
    caption = f"{name}: {len(solved)} scenarios reached, {len(missed)} missed"
    assert caption in words(part(page, name))


@pytest.mark.parametrize("name", STAGES)
def test_a_graph_is_the_skill(page: html.HtmlElement, name: str) -> None:
    """In the picture and in the tables: all nodes, all edges, the start red and square."""
    skill = load_skill(REFERENCE / name / "skill.json", RUN.actions)
    here = part(page, name)
    picture = next(e for e in here.iter("svg") if "Graph" in e.get("aria-label"))
    nodes, edges, ends, starts, rows = [], [], [], [], []
    for inner, path in ((cluster.skill, cluster.path) for cluster in clusters_of(skill)):
        view = to_networkx(inner.graph, inner.actions)
        label = dict(view.nodes(data="label"))
        nodes += [f"{path}:{one}" for one in label.values()]
        starts.append(f"{path}:{label[view.graph['start']]}")
        for a, b, outcome in view.edges(data="outcome"):
            edges.append(f"{path}:{label[a]}:{outcome}:{label[b]}")
            rows.append([label[a], outcome, label[b]])
        for node, kind in view.nodes(data="action"):
            action = inner.actions.actions[inner.actions.index(kind)]
            for outcome, good in action.terminal.items():
                ends.append(f"{path}:{label[node]}:{outcome}")
                rows.append([label[node], outcome, f"the skill {'succeeds' if good else 'fails'}"])
    assert sorted(parts(picture, "node")) == sorted(nodes)
    assert sorted(parts(picture, "edge")) == sorted(edges)
    assert sorted(parts(picture, "end")) == sorted(ends)
    red = [
        e.get("data-part").removeprefix("node:")
        for e in picture.iter("g")
        if (e.get("data-part") or "").startswith("node:")
        and any("d62728" in path.get("style", "") for path in e.iter("path"))
    ]
    assert sorted(red) == sorted(starts)
    text = {words(t) for t in picture.iter("text")}
    assert {n.split(":")[-1] for n in nodes} <= text
    tables = [cells(t)[1:] for t in here.find(".//details").iter("table")]
    assert len(tables) == len(starts)
    assert sorted(row for rows in tables for row in rows) == sorted(rows)


def test_evidence_of_a_stage(page: html.HtmlElement) -> None:
    for line, result in zip(logged(REFERENCE, "accepted"), RESULTS, strict=True):
        found = facts(part(page, line["stage"]))
        lost = f"{line['w_lost']} of {line['w_before']}"
        assert found["Solved before, lost now (eq. 1a)"] == lost
        won = f"{line['m_solved']} of {line['m_before']}"
        assert found["Scenarios to solve, solved now (eq. 1b)"] == won
        again = line["w_other_noise"]
        wanted = f"{again['succeeded']} of {again['tried']} = "
        assert found["Solved under other noise, too"].startswith(wanted)
        assert found["Generations"] == str(result["generations"])
        assert found["Nodes, levels"] == f"{result['nodes']}, {result['depth']}"


def test_all_around(page: html.HtmlElement) -> None:
    text = words(page.get_element_by_id("overall"))
    last = RESULTS[-1]["overall"]
    assert "34 of 40 = 85.0%" in text
    assert f"{last['succeeded']} of {last['tried']} reached by S3" in text


def test_evolution_counts_the_generations(page: html.HtmlElement) -> None:
    total = sum(result["generations"] for result in RESULTS)
    text = words(page.get_element_by_id("evolution"))
    assert f"over the {total} generations of the run" in text


def test_models_are_as_good_as_their_reports_say(page: html.HtmlElement) -> None:
    known = load_knowledge(REFERENCE / "S3", RUN.models.unfitted())
    report, labels = known.gamma_report, known.classifier_report
    _, *rows = table(page, "Γ in cross-validation")
    for row, name, error, rigid in zip(
        rows, report.coordinates, report.error, report.baseline_error, strict=True
    ):
        assert row == [name, f"{100 * error:.2f} cm", f"{100 * rigid:.2f} cm"]
    found = facts(page.get_element_by_id("models"))
    right = labels.balanced_accuracy
    assert found["C: balanced accuracy, cross-validated"] == f"{right:.1%}"
    count = sum(n for _, _, n in labels.reliability)
    assert f"C on {count} held-out labels" in words(page.get_element_by_id("models"))


def test_settings_and_versions(page: html.HtmlElement) -> None:
    about = json.loads((REFERENCE / "run.json").read_text())
    rows = {row[0]: row for row in table(page, "Settings")[1:]}
    settings = {**about["settings"], **about["domain_settings"]}
    later = {"driver": "", "data": [], "chance": "auto"}  # settings that there were not yet
    assert set(rows) == {*settings, *later}
    settings = {**later, **settings}
    for name, value in settings.items():
        shown, usual = rows[name][1:3]
        assert shown == ("none" if value == [] else str(value))
        assert usual == ("0" if name == "seed" else "")
    found = facts(page.get_element_by_id("settings"))
    assert found["Made with torch"] == about["torch"]
    assert found["Robot"] == "PR2"


def test_how_to_reproduce(page: html.HtmlElement) -> None:
    text = page.get_element_by_id("reproduce").text_content()
    assert f"cgtorch-train --stage S3 --seed {RUN.settings.seed} --run-dir runs/again\n" in text
    assert "cgtorch-evaluate reference --scenarios perimeter --count 1000\n" in text


@pytest.mark.usefixtures("without_pictures")
def test_commands_name_the_run_as_it_was_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """From a folder in which the report was made, what it says can be called."""
    monkeypatch.chdir(REFERENCE.parents[1])
    text = parsed(Path("runs/reference")).get_element_by_id("reproduce").text_content()
    assert "Where this run is runs/reference, it can be tried" in text
    assert "cgtorch-evaluate runs/reference --scenarios perimeter" in text
    assert "tensorboard --logdir runs/reference\n" in text


def test_the_same_run_is_the_same_page(page_bytes: bytes) -> None:
    assert report_page(RUN) == page_bytes


def test_the_last_result_of_the_paper_names_its_stage(page: html.HtmlElement) -> None:
    assert "the paper after S3: 34 of 40" in words(page.get_element_by_id("results"))
