"""How wide a text is when it is drawn."""

from functools import cache

POINTS_PER_INCH = 72


@cache
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width in inches of one line of text in the default font, `size` in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.path import Path
    from matplotlib.textpath import text_to_path

    if not text.strip():
        return 0.0
    font = FontProperties(weight="bold" if bold else "normal")
    # Not as mathematics, which a "$" in a name would be.
    vertices, codes = text_to_path.get_text_path(font, text, ismath=False)
    extents = Path(vertices, codes).get_extents()
    return float(extents.x1) * size / text_to_path.FONT_SCALE / POINTS_PER_INCH
