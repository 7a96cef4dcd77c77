"""PGPE with ClipUp of EvoTorch.

As in its example for CartPole-v1, examples/notebooks/Functional_API/problem.ipynb: a population of
100, symmetric sampling, centred ranks, the same speeds and rates, one episode of each individual
from a start of its own, observations normalised by what has been seen so far, and the network
"Linear >> Tanh >> Linear" with 16 units. Where memory is needed the hidden layer is EvoTorch's
`RNN` with 8 units. The example looks at the centre in the end, so the centre is tested, from when
the best of a generation is good enough.
"""

from typing import Any

import torch
from evotorch.algorithms.functional import pgpe, pgpe_ask, pgpe_tell
from evotorch.neuroevolution.net import str_to_net
from evotorch.neuroevolution.net.runningnorm import RunningNorm
from evotorch.neuroevolution.net.vecrl import Policy
from torch import Tensor

from standard.measure import Trial, player
from standard.peers import NEEDS_MEMORY
from standard.task import Task

POPULATION, MAX_SPEED = 100, 0.15


class Networks:
    """P individuals as a policy of lanes, equally many of each, which follow each other."""

    def __init__(self, network: Any, parameters: Tensor, norm: Any, learns: bool = False) -> None:
        """Networks with parameters (P, K); norm says how percepts are scaled, and may learn."""
        self.network, self.parameters, self.norm, self.learns = network, parameters, norm, learns

    def __call__(self, percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        """See `Policy`; what is remembered is EvoTorch's policy, with its hidden state."""
        if memory is None:
            memory = Policy(self.network)
            each = len(percept) // len(self.parameters)
            memory.set_parameters(self.parameters.repeat_interleave(each, 0))
        if self.learns:
            self.norm.update(percept, mask=live)
        scaled = self.norm.normalize(percept) if self.norm.count >= 2 else percept
        return memory(scaled), memory


def network_of(task: Task) -> Any:
    """The example's network."""
    text = f"Linear({task.inputs}, 16) >> Tanh() >> Linear(16, {task.outputs})"
    if task.name in NEEDS_MEMORY:
        text = f"RNN({task.inputs}, 8) >> Linear(8, {task.outputs})"
    return str_to_net(text)


def search(trial: Trial) -> None:
    """Go on until the centre is good on fresh starts, too."""
    torch.manual_seed(trial.seed)
    network = network_of(trial.task)
    norm = RunningNorm(shape=trial.task.inputs, dtype=torch.float32, device="cpu")
    state = pgpe(
        center_init=torch.zeros(sum(each.numel() for each in network.parameters())),
        radius_init=15 * MAX_SPEED,
        center_learning_rate=0.75 * MAX_SPEED,
        stdev_learning_rate=0.1,
        stdev_max_change=0.2,
        ranking_method="centered",
        optimizer="clipup",
        optimizer_config={"max_speed": MAX_SPEED},
        symmetric=True,
        objective_sense="max",
    )
    while trial.open:
        population = pgpe_ask(state, popsize=POPULATION)
        policy = Networks(network, population, norm, learns=True)
        fitness = trial.returns(policy, POPULATION, 1, common=False).mean(1).float()
        state = pgpe_tell(state, population, fitness)
        centre = state.optimizer_state.center.detach().clone()[None]
        trial.offer(player(Networks(network, centre, norm)), float(fitness.max()))
