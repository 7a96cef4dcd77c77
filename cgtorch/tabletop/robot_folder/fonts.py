"""Fonts for names in any writing."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from matplotlib import rcParams
from matplotlib.font_manager import FontProperties, findfont, fontManager, get_font


def fonts_for(text: str) -> list[str]:
    """The usual font, and another one with what it lacks of a text if this machine has one."""
    usual = list(rcParams["font.family"])
    lacks = {ord(each) for each in text} - _characters(findfont(FontProperties(family=usual)))
    if not lacks:
        return usual
    others = ((len(lacks & _characters(each.fname)), each.name) for each in fontManager.ttflist)
    count, name = max(others, default=(0, ""))
    return [*usual, name] if count else usual


@contextmanager
def without_glyph_warnings() -> Iterator[None]:
    """Let a character that no font has be drawn as a box without a word."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def _characters(file: str) -> set[int]:
    try:
        return set(get_font(file).get_charmap())
    except (OSError, RuntimeError):  # as it is no longer there, or broken
        return set()
