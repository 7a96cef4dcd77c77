"""Building blocks of HTML: templates, and matplotlib figures that use the page's colours."""

import io
import re
from functools import cache
from typing import TYPE_CHECKING

import jinja2
from lxml import etree
from markupsafe import Markup

from cgtorch.ground.errors import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SVG, XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
POINTS = 0.75  # pt in a CSS pixel
LEAST = 0.65  # of its width, to which a picture shrinks
STYLE = {
    "svg.fonttype": "none",  # text stays text: it can be searched and takes the page's colours
    "svg.hashsalt": "cgtorch",  # the same picture is the same file
    "font.size": 9.0,
    "font.sans-serif": ["DejaVu Sans", "Verdana"],  # as wide as what is measured, or nearly
}
"""The matplotlib settings for figures of the page."""

_COLOUR = re.compile(r"(?<=: )#([0-9a-f]{6})\b")
_REFERENCE = re.compile(r"(?<=url\(#)[^)]+")
_OF_MATPLOTLIB = re.compile(r"[A-Za-z][\w.]*_\d+")
_FRACTION = re.compile(r"(\.\d\d)\d+")


@cache
def templates(package: str) -> jinja2.Environment:
    """The HTML templates of a package; all inserted text is escaped."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        extensions=["jinja2.ext.do"],
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )


def inline_svg(figure: "Figure", key: str, label: str, scale: float = 1.0) -> Markup:
    """A figure made under `STYLE` as an `svg` element of an HTML page.

    Every colour becomes a CSS variable named after it, such as `var(--c-1c1f24, #1c1f24)`, so that
    the page can replace it in dark mode. The background is left out. On a narrow screen the picture
    shrinks down to a readable size; otherwise `scale` is the number of CSS pixels per pixel of the
    figure at 96 per inch. The `key` (letters, digits, hyphens) makes its identifiers unique on the
    page. The `label` describes the picture for screen readers.
    """
    from matplotlib import rc_context

    out = io.StringIO()
    with rc_context(STYLE):
        figure.patch.set_alpha(0)
        for axes in figure.axes:
            axes.patch.set_alpha(0)
        figure.savefig(out, format="svg")
    # Stripping comments and the like is safe: names are in attributes and text.
    # Entities of its own would be resolved by default, and `huge_tree` lifts the limit on them.
    parser = etree.XMLParser(
        resolve_entities=False, huge_tree=True, remove_comments=True, remove_blank_text=True
    )
    root = etree.fromstring(out.getvalue().encode(), parser)
    etree.strip_elements(root, *(SVG + name for name in ("metadata", "style", "title")))
    _rename(root, key)
    for element in root.iter(etree.Element):
        # Coordinates keep a hundredth of a point, which is finer than visible.
        for name in ("d", "x", "y", "width", "height", "transform"):
            if (value := element.get(name)) is not None:
                element.set(name, _FRACTION.sub(r"\1", value))
    _say_once(root)
    width, height = (scale * float(root.get(side)[:-2]) / POINTS for side in ("width", "height"))
    root.set("width", f"{width:.0f}")
    root.set("height", f"{height:.0f}")
    root.set("style", f"min-width: {LEAST * width:.0f}px")
    root.set("role", "img")
    root.set("aria-label", printable(label))
    etree.cleanup_namespaces(root)
    return Markup(etree.tostring(root, encoding="unicode"))  # noqa: S704  written by lxml


def _rename(root: etree._Element, key: str) -> None:
    """Name colours, and make identifiers unique; those of artists become `data-part`."""
    used = set()
    for element in root.iter(etree.Element):
        for name in ("clip-path", "style"):
            if (value := element.get(name)) is not None:
                used.update(_REFERENCE.findall(value))
                element.set(name, _REFERENCE.sub(lambda m: f"{key}-{m[0]}", value))
        if (style := element.get("style")) is not None:
            element.set("style", _COLOUR.sub(r"var(--c-\1, #\1)", style))
        if (target := element.get(f"{XLINK}href")) is not None:
            used.add(target.removeprefix("#"))
            del element.attrib[f"{XLINK}href"]
            element.set("href", f"#{key}-{target.removeprefix('#')}")
    for element in root.iter(etree.Element):
        if (name := element.attrib.pop("id", None)) is None:
            continue
        if name in used:
            element.set("id", f"{key}-{name}")
        elif not _OF_MATPLOTLIB.fullmatch(name):
            element.set("data-part", name)


def _say_once(root: etree._Element) -> None:
    """Move the common style of marks, of which there may be thousands, to their group."""
    for group in root.iter(f"{SVG}g"):
        styles = {mark.get("style") for mark in group}
        if len(group) > 1 and len(styles) == 1 and all(mark.tag == f"{SVG}use" for mark in group):
            if (style := styles.pop()) is None:  # all are black and without rims
                continue
            group.set("style", style)
            for mark in group:
                del mark.attrib["style"]
