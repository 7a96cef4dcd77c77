"""Write every table and plot of results, speed and comparison from docs/figures/*.json.

    python tools/make_figures.py            writes the tables into the pages, and the plots
    python tools/make_figures.py --record NAME    notes that NAME was measured with the present code

A page says `<!-- figure: NAME -->` where a table goes, and `<!-- /figure -->` after it. What stands
between them is replaced, so no table is written by hand. A figure whose code has changed since it
was measured is marked as stale in the page.
"""

import ast
import hashlib
import json
import re
import subprocess
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import click

ROOT = Path(__file__).resolve().parents[1]
FIGURES, PLOTS = Path("docs", "figures"), Path("docs", "images")
MARKED = re.compile(r"(<!-- figure: (\w+) -->\n).*?(<!-- /figure -->)", re.DOTALL)

COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)

UNSOLVED = "–"
"""The cost of what no seed has solved."""

Figure: TypeAlias = dict[str, Any]
"""A figure as its JSON file holds it: command, commit, machine, code, columns, rows, keys."""


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.option("--record", multiple=True, help="Note that this figure was measured just now.")
def command(record: tuple[str, ...]) -> None:
    """Write the pages, the plots, and what is stale."""
    for name in record:
        path = ROOT / FIGURES / f"{name}.json"
        figure = json.loads(path.read_text())
        head = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"],  # noqa: S607
            capture_output=True, text=True, check=True, cwd=ROOT,
        )  # fmt: skip
        figure |= {"commit": head.stdout.strip(), "code": code_hash(figure["depends"])}
        path.write_text(json.dumps(figure, indent=1, ensure_ascii=False) + "\n")
    figures = read_figures()
    rewrite(pages(), lambda _, text: with_figures(text, figures))
    for name, svg in plots(figures).items():
        (ROOT / PLOTS / name).write_text(svg)


def rewrite(pages: list[Path], change: Callable[[Path, str], str]) -> None:
    """Write the pages whose text, by their path and present text, is another one now."""
    for page in pages:
        text = page.read_text()
        new = change(page, text)
        if new != text:
            page.write_text(new)
            click.echo(f"{page.relative_to(ROOT)} written")


def pages() -> list[Path]:
    """The pages that may hold what is generated."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def read_figures() -> dict[str, Figure]:
    """All figures by name."""
    return {p.stem: json.loads(p.read_text()) for p in sorted((ROOT / FIGURES).glob("*.json"))}


def with_figures(text: str, figures: dict[str, Figure]) -> str:
    """A page in which every marked place holds its table."""
    return MARKED.sub(
        lambda m: f"{m[1]}\n{markdown(figures[m[2]], figures)}\n{m[3]}",
        text,
    )


def markdown(figure: Figure, figures: dict[str, Figure]) -> str:
    """A figure as a table, and how, where and when it was measured."""
    columns, rows = figure["columns"], resolved(figure, figures)
    lines = [columns, ["---"] * len(columns), *rows]
    table = "\n".join(f"| {' | '.join(row)} |" for row in lines)
    return f"{table}\n\n{origin(figure)}\n"


def origin(figure: Figure) -> str:
    """One line on how a figure came about, and whether the code has changed since."""
    if "command" not in figure:
        return str(figure["origin"])
    line = f"Measured by `{figure['command']}` at commit {figure['commit']} on {figure['machine']}."
    return line + (" **Stale:** the code has changed since then." if stale(figure) else "")


def stale(figure: Figure) -> bool:
    """Whether the code that a figure depends on is other than when it was measured."""
    return "depends" in figure and figure["code"] != code_hash(figure["depends"])


def resolved(figure: Figure, figures: dict[str, Figure]) -> list[list[str]]:
    """The rows of a figure, in which cells that refer to another figure have its value."""
    return [
        [cell if isinstance(cell, str) else referred(figures, cell) for cell in row]
        for row in figure["rows"]
    ]


def referred(figures: dict[str, Figure], cell: dict[str, Any]) -> str:
    """The value that a cell refers to, in its text: a figure, a row's first cells, a column."""
    other = figures[cell["figure"]]
    (row,) = (r for r in other["rows"] if r[: len(cell["row"])] == cell["row"])
    return str(cell.get("text", "{}")).format(row[other["columns"].index(cell["column"])])


def contradictions(figures: dict[str, Figure]) -> list[str]:
    """Values that two figures give differently for the same command, row and column."""
    found: dict[tuple[str, ...], tuple[str, str]] = {}
    wrong = []
    for name, figure in figures.items():
        keys = figure.get("keys", 1)
        for row in resolved(figure, figures) if "command" in figure else ():
            for column, value in zip(figure["columns"][keys:], row[keys:], strict=True):
                about = (figure["command"], *row[:keys], column)
                other, before = found.setdefault(about, (name, value))
                if before != value:
                    wrong.append(f"{' · '.join(about)}: {before} in {other}, {value} in {name}")
    return wrong


def code_hash(folders: list[str]) -> str:
    """A hash of all sources in some folders, or files, without comments and docstrings."""
    digest = hashlib.sha256()
    for folder in sorted(folders):
        place = ROOT / folder
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            if path.suffix in (".py", ".c", ".h", ".cu", ".inc"):
                digest.update(
                    f"{path.relative_to(ROOT)}\n{_said(path.read_text(), path.suffix)}".encode()
                )
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1000)
def _said(text: str, suffix: str) -> str:
    return _shape(ast.parse(text)) if suffix == ".py" else COMMENT.sub("", text)


def _shape(node: Any) -> str:
    """A syntax tree in words that are the same in all versions of Python."""
    if isinstance(node, list):
        return ",".join(_shape(one) for one in node if not _explains(one))
    if not isinstance(node, ast.AST):
        return repr(node)
    inner = (f"{k}={_shape(v)}" for k, v in ast.iter_fields(node) if v not in (None, []))
    return f"{type(node).__name__}({';'.join(inner)})"


def _explains(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def plots(figures: dict[str, Figure]) -> dict[str, str]:
    """All plots as SVG by file name; the same figures give the same bytes."""
    import io

    import matplotlib as mpl
    from matplotlib.figure import Figure as Drawing

    figure = figures["standard_tasks"]
    cost = figure["columns"].index("episodes")
    tasks = list(dict.fromkeys(row[0] for row in figure["rows"]))
    libraries = list(dict.fromkeys(row[1] for row in figure["rows"] if row[cost] != UNSOLVED))
    with mpl.rc_context({"svg.hashsalt": "cgtorch", "font.size": 9}):
        drawing = Drawing(figsize=(7, 3.4), layout="constrained")
        axes = drawing.subplots()
        for library, marker in zip(libraries, "osD^v", strict=False):
            rows = [r for r in figure["rows"] if r[1] == library and r[cost] != UNSOLVED]
            episodes = [int(row[cost].split()[0].replace(",", "")) for row in rows]
            where = [tasks.index(row[0]) for row in rows]
            axes.scatter(episodes, where, marker=marker, label=library)
        axes.set_yticks(range(len(tasks)), tasks)
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set_xlabel("Episodes until solved, median (fewer are better)")
        drawing.legend(loc="outside upper center", ncols=len(libraries))
        file = io.StringIO()
        drawing.savefig(file, format="svg", metadata={"Date": None})
    return {"standard-tasks.svg": re.sub(r"[ \t]+\n", "\n", file.getvalue())}


if __name__ == "__main__":
    command()
