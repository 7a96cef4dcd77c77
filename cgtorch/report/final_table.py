"""The stages of a run beside what the paper reports."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from cgtorch.report.estimate import as_time

if TYPE_CHECKING:
    from rich.table import Table

PAPER = {
    "S0": "5/5",
    "S1": "5/5",
    "S2": "4/5, not the corner",
    "S3": "3/5",
}
PAPER_PERIMETER = "34/40 = 85 %"
HEADER = (
    "stage",
    "edge",
    "ours",
    "the paper",
    "W kept",
    "fresh",
    "nodes",
    "gens",
    "time",
)
WRAPS = {"ours": 7, "the paper": 9}
LEFT = 4  # columns of text, from the left; the others are numbers
TITLE = "Objects reached"
MISSING = "–"

Result = Mapping[str, Any]
"""What a stage's result.json holds."""


def final_table(results: Sequence[Result]) -> "Table":
    """The stages and the test all around, as a table for a terminal.

    Args:
        results: of each stage in order, as stored in its result.json; what is missing or null
            becomes a dash. The perimeter is that of the last stage that was tested on it.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=TITLE,
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for i, name in enumerate(HEADER):
        # In a narrow terminal results and the paper's remarks wrap; no number is cut.
        wraps = name in WRAPS
        justify: Literal["left", "right"] = "left" if i < LEFT else "right"
        table.add_column(name, justify=justify, no_wrap=not wraps, min_width=WRAPS.get(name))
    for row in _rows(results):
        table.add_row(*map(Text, row))
    table.add_section()
    table.add_row(*map(Text, _perimeter(results)))
    return table


def final_text(results: Sequence[Result]) -> str:
    """The same as text in columns, without colour or frame."""
    rows = [HEADER, *_rows(results), _perimeter(results)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADER))]
    lines = [
        "  ".join(
            cell.ljust(width) if i < LEFT else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join([TITLE, *lines])


def _rows(results: Sequence[Result]) -> list[tuple[str, ...]]:
    return [
        (
            _text(r, "stage"),
            _text(r, "edge"),
            _share(r, "targets_succeeded", "targets"),
            PAPER.get(str(r.get("stage")), MISSING),
            _kept(r),
            _share(r.get("fresh") or {}, "succeeded", "tried"),
            _text(r, "nodes"),
            _text(r, "generations"),
            MISSING if r.get("seconds") is None else as_time(r["seconds"]),
        )
        for r in results
    ]


def _perimeter(results: Sequence[Result]) -> tuple[str, ...]:
    tested = [r for r in results if r.get("perimeter")]
    ours, stage, placement = MISSING, MISSING, "perimeter"
    if tested:
        last = tested[-1]["perimeter"]
        ours, stage = _share(last, "succeeded", "tried"), _text(tested[-1], "stage")
        placement = last.get("placement", placement)
        if last.get("tried"):
            ours += f" = {100 * last['succeeded'] / last['tried']:.3g} %"
    theirs = PAPER_PERIMETER if placement == "perimeter" else MISSING
    return (stage, placement, ours, theirs, *[""] * (len(HEADER) - 4))


def _text(data: Mapping[str, Any], key: str) -> str:
    return MISSING if data.get(key) is None else str(data[key])


def _share(data: Mapping[str, Any], part: str, whole: str) -> str:
    if data.get(part) is None or data.get(whole) is None:
        return MISSING
    return f"{data[part]}/{data[whole]}"


def _kept(result: Result) -> str:
    """How many of the earlier W the stage's skill still solves."""
    size, lost = result.get("w_size"), result.get("w_lost")
    return MISSING if size is None or lost is None else f"{size - lost}/{size}"
