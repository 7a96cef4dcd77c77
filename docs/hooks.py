"""What mkdocs writes by itself: a reference page of each package, and the help of each command.

A new package has its page, and a new command of pyproject.toml its section, without a line here.
"""

import tomllib
from importlib import import_module
from pathlib import Path

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(path.parent.name for path in (ROOT / "cgtorch").glob("*/__init__.py"))
MODULES = sorted(path.stem for path in (ROOT / "cgtorch").glob("*.py") if path.stem != "__init__")
REFERENCE = {
    **{f"reference/{name}.md": (f"cgtorch.{name}", [f"cgtorch.{name}"]) for name in PACKAGES},
    "reference/cgtorch.md": ("What all stand on", [f"cgtorch.{name}" for name in MODULES]),
}
"""Each page of the reference: its title, and the modules that it shows."""
HELPS = "<!-- every command -->"


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
    if HELPS not in markdown:
        return markdown
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    helps = (_help(name, place.partition(":")[0]) for name, place in scripts.items())
    return markdown.replace(HELPS, "\n\n".join(helps))


def _help(name: str, module: str) -> str:
    """What a command prints with --help, at a width that the page has room for."""
    command = import_module(module).command
    context = click.Context(command, info_name=name, terminal_width=80, max_content_width=80)
    return f"## {name}\n\n```text\n{command.get_help(context)}\n```"
