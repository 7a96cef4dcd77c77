"""Pages for the tests: of the reference run, of parts of it, and of one with hostile names."""

import io
import json
import shutil
from pathlib import Path
from typing import Any

from lxml import html
from rich.console import Console

from cgtorch.report import final_table
from cgtorch.report.page import report_page
from cgtorch.runs.log import LOG, Row, read_log
from cgtorch.runs.stored_run import read_run

REFERENCE = Path(__file__).parents[1] / "runs" / "reference"
STAGES = ("S0", "S1", "S2", "S3")
HOSTILE = (
    "<script>window.hit = 1</script>",
    '"><img src=x onerror="window.hit = 2">',
    "</text></svg><svg onload='window.hit = 3'>",
    "{{ 7 * 191 }}{% raw %}",
    r"$\frac{1}{$",
    "]]><!-- &lt;b&gt; &#60;i&#62;",
    "a\x00\x07\x1b[31m\x7f\x85\ud800\ufffe\u202e b",
)
"""What names could be; none of it may become anything but text."""


def thinned(target: Path, *stages: str, models: bool = True, generations: bool = True) -> Path:
    """A copy of the reference run with some of its stages, as if the others were not made."""
    skipped = {LOG, "by_rows", *(name for name in STAGES if name not in stages)}
    shutil.copytree(REFERENCE, target, ignore=lambda where, names: skipped & set(names))
    left = {name for name, kept in (("models", models), ("generation", generations)) if not kept}
    write_log(target, [
        row for row in read_log(REFERENCE)
        if row["event"] not in left and (row["event"] != "ended" or len(stages) == len(STAGES))
        and row["stage"] in ("start", *STAGES[: len(stages) + 1])
        and (row["event"] not in ("accepted", "result") or row["stage"] in stages)
    ])  # fmt: skip
    return target


def write_log(run: Path, rows: list[Row]) -> None:
    (run / LOG).write_text("".join(json.dumps({"time": 0, **row}) + "\n" for row in rows))


def change_rows(run: Path, event: str, **values: Any) -> None:
    """Give all rows of a kind other values."""
    lines = [json.loads(line) for line in (run / LOG).read_text().splitlines()]
    write_log(run, [row | values if row["event"] == event else row for row in lines])


def rewrite(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data))


def changed(path: Path, **values: Any) -> None:
    """Give an object in a JSON file other values."""
    rewrite(path, json.loads(path.read_text()) | values)


def hostile_run(target: Path) -> Path:
    """A run with one stage in which every text that can be is hostile."""
    folder = thinned(target / f"run {HOSTILE[1]} ' {{{{ 7 * 191 }}}} $", "S0")
    one = "".join(HOSTILE)
    changed(folder / "run.json", cgtorch=one, torch={one: [one]})
    changed(folder / "robot" / "robot.json", name=one)
    score = {"scenarios": one, "tried": 4, "succeeded": 3}
    change_rows(folder, "result", scenarios=one, fresh=score, overall=score)
    change_rows(folder, "candidate", candidate=one)
    change = {"event": "changed", "stage": one, "set_aside": None}
    change["changed"] = {one: [one, one], "population": [one, 600], "torch": [one]}
    write_log(folder, [*read_log(folder), change])
    text = (folder / "S0" / "skill.json").read_text()
    # A run with a skill of another name is refused.
    rewrite(folder / "S0" / "skill.json", json.loads(text.replace('"S0.1', json.dumps(one)[:-1])))
    return folder


def parsed(folder: Path) -> html.HtmlElement:
    """The page of a run as a tree."""
    return html.document_fromstring(report_page(read_run(folder)).decode())


def final_text(results: list[dict[str, Any]], domain: Any) -> str:
    """The final table as text on a wide screen, without rules and empty lines."""
    screen = Console(file=io.StringIO(), width=200)
    screen.print(final_table(results, domain))
    lines = screen.file.getvalue().splitlines()
    return "\n".join(line.rstrip() for line in lines if line.strip(" ─"))


def words(element: html.HtmlElement) -> str:
    """The text of an element on one line."""
    return " ".join(element.text_content().split())
