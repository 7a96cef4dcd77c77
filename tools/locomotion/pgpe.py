"""PGPE with ClipUp of EvoTorch (Toklu et al., "ClipUp", PPSN 2020, arXiv:2008.02387).

Settings are those of the library's example for Walker2d, `walker` in examples/scripts/rl_clipup.py:
a linear policy with a bias, observations normalised by what has been seen so far, 100 individuals
and up to 800 while an update has fewer than 75,000 steps. Like there, the bonus for survival is
taken off, of the Hopper, too.
"""

import numpy as np
import torch
from evotorch.algorithms.functional import pgpe, pgpe_ask, pgpe_tell

from locomotion.episodes import Linear, Numbers, Seen, Trial

MAX_SPEED = 0.015
POPULATION, LARGEST, LEAST_STEPS = 100, 800, 75_000
TOLLS = {"Walker2d-v5": 1.0, "Hopper-v5": 1.0, "Ant-v5": 1.0}


def search(trial: Trial) -> Linear:
    """The centre after as many updates as the trial's steps allow."""
    torch.manual_seed(trial.seed)
    toll, seen = TOLLS.get(trial.name, 0.0), Seen.nothing(trial.inputs)
    state = pgpe(
        center_init=torch.zeros(trial.outputs * (trial.inputs + 1)),
        radius_init=15 * MAX_SPEED,
        center_learning_rate=0.75 * MAX_SPEED,
        stdev_learning_rate=0.1,
        stdev_max_change=0.2,
        ranking_method="centered",
        optimizer="clipup",
        optimizer_config={"max_speed": MAX_SPEED, "momentum": 0.9},
        symmetric=True,
        objective_sense="max",
    )
    while trial.open:
        before, rows, returns = trial.steps, list[torch.Tensor](), list[float]()
        while trial.steps - before < LEAST_STEPS and len(returns) < LARGEST and trial.open:
            drawn = pgpe_ask(state, popsize=POPULATION)
            rows.append(drawn)
            for row in drawn.numpy().astype(np.float64):
                returns.append(trial.play(policy_of(row, trial, seen), toll, seen))
        state = pgpe_tell(state, torch.cat(rows), torch.tensor(returns))
        trial.look(policy_of(_centre(state), trial, seen))
    return policy_of(_centre(state), trial, seen)


def _centre(state: "object") -> Numbers:
    return state.optimizer_state.center.numpy().astype(np.float64)  # type: ignore[attr-defined]


def policy_of(parameters: Numbers, trial: Trial, seen: Seen) -> Linear:
    """The policy with these parameters, row by row, and then the bias."""
    weights = parameters[: -trial.outputs].reshape(trial.outputs, trial.inputs)
    return Linear(weights, parameters[-trial.outputs :], seen.mean, seen.deviation)
