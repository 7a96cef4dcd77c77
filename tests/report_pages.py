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


def thinned(target: Path, *stages: str, models: bool = True, events: bool = True) -> Path:
    """A copy of the reference run with some of its stages, as if the others were not made."""
    skipped = {"summary.json", *(name for name in STAGES if name not in stages)}
    shutil.copytree(REFERENCE, target, ignore=lambda where, names: skipped & set(names))
    for name in stages if models else ():
        if not (target / name / "gamma.safetensors").is_file():
            for path in (REFERENCE / "S3").glob("*.safetensors"):
                shutil.copy(path, target / name)
    index = json.loads((target / "ledger" / "index.json").read_text())
    index["skills"] = [line for line in index["skills"] if line["name"] in stages]
    rewrite(target / "ledger" / "index.json", index)
    if not events:
        shutil.rmtree(target / "by_rows")
        for path in target.glob("events.out*"):
            path.unlink()
    return target


def rewrite(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data))


def changed(path: Path, **values: Any) -> None:
    """Give an object in a JSON file other values."""
    rewrite(path, json.loads(path.read_text()) | values)


def hostile_run(target: Path) -> Path:
    """A run with one stage in which every text that can be is hostile."""
    folder = thinned(target / f"run {HOSTILE[1]} ' {{{{ 7 * 191 }}}} $", "S0")
    one = "".join(HOSTILE)
    history = [
        {"before": one, "changed": {one: [one, one], "population": [one, 600]}},
        {"before": "S1", "changed": one},
        one,
    ]
    changed(folder / "run.json", cgtorch=one, torch={one: [one]}, history=history)
    changed(folder / "robot" / "robot.json", name=one)
    score = {"scenarios": one, "tried": 4, "succeeded": 3}
    changed(
        folder / "S0" / "result.json", stage=one, scenarios=one, fresh=score, overall=score,
        search_seconds=one,
    )  # fmt: skip
    rewrite(folder / "summary.json", {"target": one, "minutes": one, one: one})
    text = (folder / "S0" / "skill.json").read_text()
    skill = json.loads(text.replace('"S0.1', json.dumps(one)[:-1]))
    rewrite(folder / "S0" / "skill.json", skill | {"name": one})
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
