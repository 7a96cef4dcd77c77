"""Augmented random search, V2-t, as published.

The source is Mania et al., "Simple random search provides a competitive approach to reinforcement
learning", NeurIPS 2018, arXiv:1803.07055. A linear policy without a bias sees observations that are
normalised by all that was seen so far. Each update plays policies on both sides along random
directions, keeps the directions with the best returns, and divides the step by the standard
deviation of these returns. Settings are the paper's, and those of the authors' program where the
paper has none.
"""

from dataclasses import dataclass

import numpy as np

from locomotion.episodes import Linear, Numbers, Seen, Trial


@dataclass(frozen=True)
class Settings:
    """Directions N of an update, those kept b, the step α, the noise ν, and a toll for each step.

    The toll takes off the bonus for survival.
    """

    directions: int = 8
    kept: int = 8
    step: float = 0.02
    noise: float = 0.03
    toll: float = 0.0


SETTINGS = {
    "Swimmer-v5": Settings(1, 1, 0.02, 0.01),
    "Hopper-v5": Settings(8, 4, 0.01, 0.025, 1.0),
    "HalfCheetah-v5": Settings(32, 4, 0.02, 0.03),
    "Walker2d-v5": Settings(40, 30, 0.03, 0.025, 1.0),
    "Ant-v5": Settings(60, 20, 0.015, 0.025, 1.0),
}
"""Those of the paper's table for V2-t; of other environments, the program's own."""


def search(trial: Trial) -> Linear:
    """The policy after as many updates as the trial's steps allow."""
    settings = SETTINGS.get(trial.name, Settings())
    weights, seen = np.zeros((trial.outputs, trial.inputs)), Seen.nothing(trial.inputs)
    while trial.open:
        normal = seen.mean, seen.deviation
        directions = trial.generator.standard_normal((settings.directions, *weights.shape))
        shown = Seen.nothing(trial.inputs)
        returns = np.array(
            [
                [
                    trial.play(
                        Linear(weights + side * settings.noise * direction, 0.0, *normal),
                        settings.toll,
                        shown,
                    )
                    for side in (1, -1)
                ]
                for direction in directions
            ]
        )
        seen.join(shown)
        weights = weights + update(directions, returns, settings)
        trial.look(Linear(weights, 0.0, seen.mean, seen.deviation))
    return Linear(weights, 0.0, seen.mean, seen.deviation)


def update(directions: Numbers, returns: Numbers, settings: Settings) -> Numbers:
    """The step (U, D) by N directions (N, U, D) with returns (N, 2) on either side of them."""
    best = np.argsort(-returns.max(1), kind="stable")[: settings.kept]
    spread = returns[best].std()
    if spread == 0:
        return np.zeros(directions.shape[1:])
    slopes = returns[best, 0] - returns[best, 1]
    return settings.step / (len(best) * spread) * np.tensordot(slopes, directions[best], 1)
