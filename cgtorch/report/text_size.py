"""How wide a text is when it is drawn."""

from functools import cache

POINTS_PER_INCH = 72


@cache
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width in inches of one line of text in the default font, `size` in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    if not text.strip():
        return 0.0
    font = FontProperties(weight="bold" if bold else "normal")
    extents = TextPath((0, 0), text, size=size, prop=font).get_extents()
    return float(extents.x1) / POINTS_PER_INCH
