"""What mkdocs writes by itself: reference pages of packages, helps of commands, and settings.

A new package has its page, and a new command of pyproject.toml its section, without a line here.
"""

import tomllib
from dataclasses import Field, fields
from importlib import import_module
from pathlib import Path
from typing import Any

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.settings import MOST
from cgtorch.runs.goal import Goal
from cgtorch.runs.settings import RunSettings
from cgtorch.tabletop.settings import TabletopSettings

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(path.parent.name for path in (ROOT / "cgtorch").glob("*/__init__.py"))
MODULES = sorted(path.stem for path in (ROOT / "cgtorch").glob("*.py") if path.stem != "__init__")
REFERENCE = {
    **{f"reference/{name}.md": (f"cgtorch.{name}", [f"cgtorch.{name}"]) for name in PACKAGES},
    "reference/cgtorch.md": ("cgtorch", [f"cgtorch.{name}" for name in MODULES]),
}
"""Each page of the reference: its title, and the modules that it shows."""
OTHER_DEFAULTS = {
    "tabletop": TabletopSettings.run_defaults,
    "Gymnasium": GymnasiumSettings.run_defaults,
}
"""Defaults of settings of a run where they are others than usual, by domain."""
HELPS, SETTINGS = "<!-- every command -->", "<!-- every setting -->"


def on_config(config: MkDocsConfig) -> None:
    """Enter the pages of the reference in the navigation."""
    (reference,) = (part["Reference"] for part in config.nav or [] if "Reference" in part)
    reference.extend({title: path} for path, (title, _) in REFERENCE.items())


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Make the pages of the reference."""
    for path, (title, modules) in REFERENCE.items():
        shown = "\n\n".join(f"::: {module}" for module in modules)
        files.append(File.generated(config, path, content=f"---\ntitle: {title}\n---\n{shown}\n"))


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write what the commands say of themselves to where the page asks for it."""
    if SETTINGS in markdown:
        return markdown.replace(SETTINGS, settings_tables())
    if HELPS not in markdown:
        return markdown
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    helps = (_help(name, place.partition(":")[0]) for name, place in scripts.items())
    return markdown.replace(HELPS, "\n\n".join(helps))


def settings_tables() -> str:
    """All settings of a run, of its goal and of the library's domains, as tables."""
    groups = {
        "Every run": RunSettings,
        "The target of --stage auto": Goal,
        "The tabletop": TabletopSettings,
        "Gymnasium environments": GymnasiumSettings,
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
    return f"{about['least']:g}{most or ' or more'}"


def _help(name: str, module: str) -> str:
    """What a command prints with --help, at a width that the page has room for."""
    command = import_module(module).command
    context = click.Context(command, info_name=name, terminal_width=80, max_content_width=80)
    return f"## {name}\n\n```text\n{command.get_help(context)}\n```"
