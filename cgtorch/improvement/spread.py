"""How many scenarios a generation needs, by the measured spread of what individuals get on them."""

from dataclasses import dataclass

from torch import Tensor

from cgtorch.evolution.fitness import WORTHLESS

FEWEST, MOST = 2, 256  # scenarios of a generation of a search
FEW, MANY = 0.3, 0.6  # reliability below which there will be more scenarios, and above which fewer
MEMORY = 0.7  # weight of the past in the smoothed reliability
ENOUGH = 4  # individuals to measure it


@dataclass(frozen=True)
class Need:
    """The number of scenarios of the next generation, and the smoothed reliability so far."""

    scenarios: int = FEWEST
    reliability: float = (FEW + MANY) / 2

    def after(self, scores: Tensor, most: int = MOST, fewest: int = FEWEST) -> "Need":
        """The need after a generation with scores (P, B), from `fewest` to `most` scenarios."""
        now = max(-1.0, reliability(scores))
        smooth = MEMORY * self.reliability + (1 - MEMORY) * now
        count = self.scenarios
        if smooth < FEW:
            count = max(count, min(MOST, most, -(-count * 3 // 2)))
        elif smooth > MANY:
            count = min(count, max(fewest, count * 4 // 5))
        return Need(count, smooth)


def reliability(scores: Tensor) -> float:
    """The share of the variance of P individuals' mean scores (P, B) that is not due to scenarios.

    All meet the same B scenarios, whose own difficulty does not count. It is 1 - F⁻¹ of a two-way
    analysis of variance (Hoyt, "Test reliability estimated by analysis of variance", Psychometrika
    6, 1941), 1 where too little is known, and below 0 if the means differ less than by chance.
    Individuals that did not finish an episode are left out.
    """
    scores = scores[(scores > WORTHLESS).all(1)].double()
    p, b = scores.shape
    if p < ENOUGH or b < 2:
        return 1.0
    means = scores.mean(1)
    spread = float(means.var())
    rest = scores - means[:, None] - scores.mean(0) + means.mean()
    noise = float(rest.square().sum()) / ((p - 1) * (b - 1)) / b
    if spread <= 0:
        return 0.0 if noise > 0 else 1.0
    return 1 - noise / spread
