"""The stages of a run as a table, beside what others report of them."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from cgtorch.report.estimate import as_time

if TYPE_CHECKING:
    from rich.table import Table

    from cgtorch.domains.domain import Domain

COLUMNS = ("stage", "scenarios", "ours", "published", "W kept", "fresh", "nodes", "gens", "time")
PUBLISHED = 3  # the column of what others report
WRAPS = {"ours": 7}
LEFT = 4  # columns of text, from the left; the others are numbers
MISSING = "–"

Result = Mapping[str, Any]
"""What a stage's result.json holds."""


def final_table(results: Sequence[Result], domain: "Domain[Any]") -> "Table":
    """The stages and the test on all kinds of scenarios, as a table for a terminal.

    Args:
        results: of each stage in order, as stored in its result.json; what is missing or null
            becomes a dash. The last line is that of the last stage that was tested on all.
        domain: what the run is about.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=domain.solved[1],
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    header, rows = _table(results, domain)
    left = LEFT - (len(header) < len(COLUMNS))
    for i, name in enumerate(header):
        # In a narrow terminal results wrap; no number is cut.
        wraps = name in WRAPS
        justify: Literal["left", "right"] = "left" if i < left else "right"
        table.add_column(name, justify=justify, no_wrap=not wraps, min_width=WRAPS.get(name))
    for row in rows[:-1]:
        table.add_row(*map(Text, row))
    table.add_section()
    table.add_row(*map(Text, rows[-1]))
    return table


def final_text(results: Sequence[Result], domain: "Domain[Any]") -> str:
    """The same as text in columns, without colour or frame."""
    header, body = _table(results, domain)
    rows, left = [header, *body], LEFT - (len(header) < len(COLUMNS))
    widths = [max(len(row[i]) for row in rows) for i in range(len(header))]
    lines = [
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join([domain.solved[1], *lines])


def _table(
    results: Sequence[Result], domain: "Domain[Any]"
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """The header and all rows; without the column of what others report if there is nothing."""
    header = [*COLUMNS]
    header[PUBLISHED] = domain.publisher
    rows = [header, *map(list, _rows(results, domain)), list(_overall(results, domain))]
    if not domain.published:
        for row in rows:
            del row[PUBLISHED]
    first, *others = map(tuple, rows)
    return first, others


def _rows(results: Sequence[Result], domain: "Domain[Any]") -> list[tuple[str, ...]]:
    published = domain.published
    return [
        (
            _text(r, "stage"),
            _text(r, "scenarios"),
            _share(r, "targets_succeeded", "targets") if r.get("targets") else MISSING,
            published[name].text if (name := str(r.get("stage"))) in published else MISSING,
            _kept(r),
            _share(r.get("fresh") or {}, "succeeded", "tried"),
            _text(r, "nodes"),
            _text(r, "generations"),
            MISSING if r.get("seconds") is None else as_time(r["seconds"]),
        )
        for r in results
    ]


def _overall(results: Sequence[Result], domain: "Domain[Any]") -> tuple[str, ...]:
    tested = [r for r in results if r.get("overall")]
    ours, stage, kind = MISSING, MISSING, domain.usual_kind
    if tested:
        last = tested[-1]["overall"]
        ours, stage = _share(last, "succeeded", "tried"), _text(tested[-1], "stage")
        kind = last.get("scenarios", kind)
        if last.get("tried"):
            ours += f" = {100 * last['succeeded'] / last['tried']:.3g} %"
        if last.get("mean_return") is not None:
            ours += f", mean return {last['mean_return']:.5g}"
    theirs = domain.published.get("") if kind == domain.usual_kind else None
    said = (
        MISSING
        if theirs is None
        else f"{theirs.text} = {100 * theirs.succeeded / theirs.tried:.3g} %"
    )
    return (stage, kind, ours, said, *[""] * (len(COLUMNS) - 4))


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
