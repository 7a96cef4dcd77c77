"""Domains of somebody else's, as the text of modules that commands import if they may."""

from pathlib import Path

EXAMPLE = (Path(__file__).parents[2] / "examples" / "cart.py").read_text()
"""The cart of the example, which has no settings."""

OWN_CART = (
    EXAMPLE
    + '''

from cgtorch import DomainSettings, option


@dataclass(frozen=True)
class CartSettings(DomainSettings):
    """Settings of one's own."""

    run_defaults = {"practice": 77}

    wind: float = option(0.25, "Strongest wind, m.", least=0, most=1)
    colour: str = option("red", "Of the cart.", choices=("red", "blue"))


class Cart(Cart):
    """With kinds of scenarios, stages and settings of its own."""

    settings_type = CartSettings
    kinds = ("calm", "windy")
    stages = {"up": "calm", "down": "calm"}

    def draw(self, kind, count, generator):
        drawn = super().draw(kind, count, generator)
        return Carts(drawn.place, drawn.wind * (4 * self.settings.wind if kind == "windy" else 0))
'''
)
"""A cart with settings, two kinds of scenarios and two stages."""

IMPORTED = """
from pathlib import Path

Path(__file__).with_name("imported").write_text("yes")
"""
"""What leaves a trace once a module is imported."""
