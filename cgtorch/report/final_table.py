"""The stages of a run as a table, beside published results."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from cgtorch.report.estimate import as_time

if TYPE_CHECKING:
    from rich.table import Table

    from cgtorch.domains.domain import Domain

MISSING = "–"

Result = Mapping[str, Any]
"""The content of a stage's result.json."""


def final_table(results: Sequence[Result], domain: "Domain[Any]") -> "Table":
    """The results of stages, and below them the last test on all kinds of scenarios.

    A missing value is a dash. There is a column of published results only if there are any.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    pictures = domain.pictures(domain)
    table = Table(
        title=pictures.solved[1], title_justify="left", header_style="bold", box=SIMPLE_HEAD,
        caption=Text(_overall(results, domain)), caption_justify="left", caption_style="",
        pad_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    beside = ["ours", pictures.publisher] if pictures.published else ["solved"]
    texts = ["stage", "scenarios", *beside]
    for name in (*texts, "W kept", "fresh", "nodes", "gens", "time"):
        justify: Literal["left", "right"] = "left" if name in texts else "right"
        table.add_column(name, justify=justify, no_wrap=True)
    for result in results:
        table.add_row(*map(Text, _row(result, domain)))
    return table


def _row(result: Result, domain: "Domain[Any]") -> list[str]:
    every = domain.pictures.published
    published = every.get(str(result.get("stage")))
    size, lost = result.get("w_size"), result.get("w_lost")
    return [
        _text(result, "stage"),
        _text(result, "scenarios"),
        _share(result, "targets_succeeded", "targets") if result.get("targets") else MISSING,
        *([published.text if published else MISSING] if every else []),
        MISSING if size is None or lost is None else f"{size - lost}/{size}",
        _share(result.get("fresh") or {}, "succeeded", "tried"),
        _text(result, "nodes"),
        _text(result, "generations"),
        MISSING if result.get("seconds") is None else as_time(result["seconds"]),
    ]


def _overall(results: Sequence[Result], domain: "Domain[Any]") -> str:
    """A line on the last test on all kinds of scenarios, and on what is published; "" if none."""
    tested = [r for r in results if r.get("overall")]
    if not tested:
        return ""
    last = tested[-1]["overall"]
    kind = last.get("scenarios", domain.kinds[0])
    ours = _share(last, "succeeded", "tried")
    if last.get("tried"):
        ours += f" = {100 * last['succeeded'] / last['tried']:.3g} %"
    if last.get("mean_return") is not None:
        ours += f", mean return {last['mean_return']:.5g}"
    said = f"{_text(tested[-1], 'stage')} on {kind}: {ours}."
    pictures = domain.pictures
    theirs = pictures.published.get("") if kind == domain.kinds[0] else None
    if theirs:
        after = f" after {[*domain.stages][-1]}" if domain.stages else ""
        share = f"{theirs.text} = {100 * theirs.succeeded / theirs.tried:.3g} %"
        publisher = pictures.publisher[:1].upper() + pictures.publisher[1:]
        said += f" {publisher}{after}: {share}."
    return said


def _text(data: Mapping[str, Any], key: str) -> str:
    return MISSING if data.get(key) is None else str(data[key])


def _share(data: Mapping[str, Any], part: str, whole: str) -> str:
    if data.get(part) is None or data.get(whole) is None:
        return MISSING
    return f"{data[part]}/{data[whole]}"
