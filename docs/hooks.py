"""What mkdocs writes by itself: reference pages of packages.

A new package has its page without a line here.
"""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(path.parent.name for path in (ROOT / "cgtorch").glob("*/__init__.py"))
MODULES = sorted(path.stem for path in (ROOT / "cgtorch").glob("*.py") if path.stem != "__init__")
REFERENCE = {
    **{f"reference/{name}.md": (f"cgtorch.{name}", [f"cgtorch.{name}"]) for name in PACKAGES},
    "reference/cgtorch.md": ("cgtorch", [f"cgtorch.{name}" for name in MODULES]),
}
"""Each page of the reference: its title, and the modules that it shows."""
LINKS = "<!-- generated: links -->"
"""Behind this are lines for code hosts alone; see `tools/make_reference.py`."""


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
    """Leave out where names of the code are defined, as they lead to their reference here."""
    return markdown.split(LINKS)[0]
