"""Write what pages show of the code: helps of commands, tables of settings, links to the sources.

    python tools/make_reference.py

What stands in a page between `<!-- generated: commands -->` and `<!-- /generated -->` is replaced,
and so it is with `settings`. The site links names of the code to its reference. So that they are
links on a code host, too, a page that has such names ends with `<!-- generated: links -->`, behind
which each name has the file where it is defined. `docs/hooks.py` takes these lines out of the site.
"""

import inspect
import os
import re
import sys
import tomllib
from collections.abc import Callable
from dataclasses import Field, fields
from importlib import import_module
from pathlib import Path
from typing import Any

import click
from make_figures import pages, rewrite

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.settings import MOST
from cgtorch.manipulation.settings import ManipulationSettings
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.tabletop.settings import TabletopSettings

ROOT = Path(__file__).resolve().parents[1]
MARKED = re.compile(r"(<!-- generated: (commands|settings) -->\n).*?(<!-- /generated -->)", re.S)
LINKS = "<!-- generated: links -->"
NAMED = re.compile(r"\]\[(cgtorch[\w.]*)\]|\[`(cgtorch[\w.]*)`\]\[\]")
"""A name of the code with a text of its own, or without one."""
OTHER_DEFAULTS = {
    "tabletop": TabletopSettings.run_defaults,
    "Gymnasium": GymnasiumSettings.run_defaults,
    "arms": ManipulationSettings.run_defaults,
}
"""Defaults of settings of a run where they are others than usual, by domain."""


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
def command() -> None:
    """Write the pages."""
    rewrite(pages(), written)


def written(page: Path, text: str) -> str:
    """The text of a page with what is generated."""
    made: dict[str, Callable[[], str]] = {"commands": helps, "settings": settings_tables}
    text = MARKED.sub(lambda m: f"{m[1]}\n{made[m[2]]()}\n\n{m[3]}", text)
    text = text.split(LINKS)[0].rstrip() + "\n"
    names = {(name or f"`{alone}`"): name or alone for name, alone in NAMED.findall(text)}
    lines = [f"[{label}]: {_source(page, name)}" for label, name in sorted(names.items())]
    return "\n".join([text, LINKS, "", *lines, ""]) if lines else text


def _source(page: Path, name: str) -> str:
    """Where a name of the code is defined, as seen from a page."""
    module, inner = name, []
    while True:
        try:
            found = import_module(module)
            break
        except ModuleNotFoundError:
            module, _, last = module.rpartition(".")
            inner.insert(0, last)
    for part in inner:
        found = getattr(found, part)
        module = getattr(found, "__module__", module)
    file = Path(inspect.getfile(sys.modules[module]))
    place = file.parent if file.name == "__init__.py" else file
    return Path(os.path.relpath(place, page.parent)).as_posix()


def helps() -> str:
    """What each command prints with --help."""
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    return "\n\n".join(_help(name, place.partition(":")[0]) for name, place in scripts.items())


def _help(name: str, module: str) -> str:
    """What a command prints with --help, at a width that the page has room for."""
    shown = import_module(module).command
    context = click.Context(shown, info_name=name, terminal_width=80, max_content_width=80)
    return f"## {name}\n\n```text\n{shown.get_help(context)}\n```"


def settings_tables() -> str:
    """All settings of a run, of its goal and of the library's domains, as tables."""
    groups = {
        "Every run": RunSettings,
        "The target of --stage auto": Goal,
        "The tabletop": TabletopSettings,
        "Gymnasium environments": GymnasiumSettings,
        "Arms": ManipulationSettings,
    }
    return "\n\n".join(f"## {title}\n\n{_settings(kind)}" for title, kind in groups.items())


def _settings(kind: type) -> str:
    rows = [
        "| setting | meaning, and when to change it | default | values | fixed |",
        "|---|---|---|---|---|",
    ]
    for f in fields(kind):
        about = f.metadata
        fixed = "yes" if about["fixed"] else "no"
        meaning = f"{about['help']} *{about['when']}*"
        cells = f"`{f.name}`", meaning, _default(kind, f), _values(f), fixed
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def _default(kind: type, f: Field[Any]) -> str:
    """The usual default, and the others that domains have."""
    if isinstance(f.default, str | tuple) and not f.default:
        return "none"
    usual = f"`{f.default:.4g}`" if isinstance(f.default, float) else f"`{f.default}`"
    others = OTHER_DEFAULTS.items() if kind is RunSettings else ()
    return "; ".join([usual, *(f"{who}: `{own[f.name]}`" for who, own in others if f.name in own)])


def _values(f: Field[Any]) -> str:
    about = f.metadata
    if about["choices"]:
        return ", ".join(f"`{choice}`" for choice in about["choices"])
    if isinstance(f.default, str | tuple):
        return "text" if isinstance(f.default, str) else "texts"
    most = "" if about["most"] >= MOST else f" to {about['most']:g}"
    also = "".join(f"{value}, " for value in about["also"])
    return f"{also}{about['least']:g}{most or ' or more'}"


if __name__ == "__main__":
    command()
