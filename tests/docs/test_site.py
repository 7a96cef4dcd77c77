"""The documentation builds without a warning, asks nothing of other hosts, leaves nothing out."""

import json
import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOADS = {
    *(("script", "src"), ("link", "href"), ("img", "src"), ("img", "srcset"), ("iframe", "src")),
    *(("source", "src"), ("source", "srcset"), ("video", "src"), ("audio", "src")),
    *(("embed", "src"), ("object", "data"), ("use", "href"), ("image", "href"), ("form", "action")),
}
"""What a browser fetches by itself, or sends to; links are left alone."""
FOREIGN = re.compile(r"^\s*(?:https?:)?//", re.IGNORECASE)
FOREIGN_STYLE = re.compile(r"(?:url\(|@import)\s*['\"]?\s*(?:https?:)?//", re.IGNORECASE)
FETCHERS = {"mermaid", "md-source"}
"""Classes of elements for which the theme's scripts would ask other hosts."""


class Page(HTMLParser):
    """What a page loads from elsewhere, and its identifiers."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.foreign: list[str] = []
        self.pictures: list[str] = []
        self.ids: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            text = value or ""
            if (tag, name) in LOADS and FOREIGN.search(text):
                self.foreign.append(f"{tag} {name} {text}")
            if name == "style" and FOREIGN_STYLE.search(text):
                self.foreign.append(f"style {text}")
            if name == "class" and FETCHERS & set(text.split()):
                self.foreign.append(f"class {text}")
            if (tag, name) == ("img", "src") and not FOREIGN.search(text):
                self.pictures.append(text)
            if name == "id":
                self.ids.add(text)


def test_what_would_be_foreign() -> None:
    foreign = [
        '<script src="https://unpkg.com/x.js"></script>',
        '<link rel="stylesheet" href="//fonts.googleapis.com/css">',
        '<p style="background: url(http://a.b/c.png)">',
        '<pre class="mermaid">',
    ]
    for text in foreign:
        assert len(Page(text).foreign) == 1, text
    assert Page('<a href="https://a.b"><img src="images/c.png"><script src="d.js">').foreign == []


def test_the_site(tmp_path: Path) -> None:
    """One test, as there is one build."""
    # With --quiet, warnings would be neither shown nor counted.
    words = ["-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    ended = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
    )
    assert ended.returncode == 0, ended.stderr
    assert "WARNING" not in ended.stderr
    site = tmp_path / "site"
    pages = {
        path.relative_to(site).as_posix(): Page(path.read_text()) for path in site.rglob("*.html")
    }
    for path in site.rglob("*.html"):  # a link to no known name of the code stays as written
        assert "][cgtorch" not in path.read_text(), path.relative_to(site)
    assert {name: page.foreign for name, page in pages.items() if page.foreign} == {}
    for name, page in pages.items():
        for picture in page.pictures:
            assert (site / name).parent.joinpath(picture).is_file(), f"{picture} of {name}"
    for style in site.rglob("*.css"):
        assert not FOREIGN_STYLE.search(style.read_text()), style
    assert not list(site.rglob("*.py*"))

    for package in (path.parent for path in (ROOT / "cgtorch").glob("*/__init__.py")):
        names = pages[f"reference/{package.name}.html"].ids
        for module in package.glob("[a-z]*.py"):
            assert f"cgtorch.{package.name}.{module.stem}" in names
    for module in (ROOT / "cgtorch").glob("[a-z]*.py"):
        assert f"cgtorch.{module.stem}" in pages["reference/cgtorch.html"].ids
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert set(scripts) <= pages["commands.html"].ids

    index = json.loads((site / "search" / "search_index.json").read_text())
    assert {"concepts.html", "tools.html", "results.html"} <= {d["location"] for d in index["docs"]}


def test_every_tool_is_explained() -> None:
    text = (ROOT / "docs" / "tools.md").read_text()
    explained = re.findall(r"^### (\w+\.py)$", text, re.MULTILINE)
    tools = ROOT / "tools"
    assert sorted(explained) == sorted(path.name for path in tools.glob("*.py"))
    for folder in (path.parent.name for path in tools.glob("*/__init__.py")):
        assert f"`tools/{folder}/`" in text
    for name in explained:
        section = text.split(f"### {name}\n")[1].split("\n### ")[0]
        assert f"    python tools/{name}" in section or "    make " in section
