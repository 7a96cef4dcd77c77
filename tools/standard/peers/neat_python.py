"""NEAT of neat-python.

As in its example examples/lunar-lander: a population of 150 with the configuration of that example
(neat_python.ini), and the mean of 5 episodes of each network, which begin at starts of its own.
Where memory is needed networks are recurrent, which is `feed_forward = False`, as in its
examples/memory-fixed.
"""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import neat
import torch
from torch import Tensor

from standard.measure import Trial, player
from standard.peers import NEEDS_MEMORY
from standard.task import Task

EPISODES = 5
TEMPLATE = Path(__file__).with_name("neat_python.ini")


class Networks:
    """Networks of P genomes as a policy of lanes, equally many of each, which follow each other."""

    def __init__(self, genomes: Sequence[Any], config: Any, recurrent: bool) -> None:
        """The networks of genomes."""
        self.recurrent = recurrent
        kind = neat.nn.RecurrentNetwork if recurrent else neat.nn.FeedForwardNetwork
        self.networks = [kind.create(genome, config) for genome in genomes]

    def __call__(self, percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        """See `Policy`; what is remembered are the networks of the lanes, with their states."""
        if memory is None:
            each = len(percept) // len(self.networks)
            memory = [self._again(network) for network in self.networks for _ in range(each)]
        rows, seen = live.nonzero()[:, 0].tolist(), percept.tolist()
        outputs = [memory[row].activate(seen[row]) for row in rows]
        control = torch.zeros(len(percept), len(self.networks[0].output_nodes))
        control[live] = torch.tensor(outputs)
        return control, memory

    def _again(self, network: Any) -> Any:
        """The same network with a state of its own, if it has one."""
        if not self.recurrent:
            return network
        parts = network.input_nodes, network.output_nodes, network.node_evals
        return neat.nn.RecurrentNetwork(*parts)


def config_of(task: Task) -> Any:
    """The example's configuration for a task."""
    text = TEMPLATE.read_text(encoding="utf-8").format(
        inputs=task.inputs, outputs=task.outputs, feed_forward=task.name not in NEEDS_MEMORY
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config"
        path.write_text(text, encoding="utf-8")
        parts = neat.DefaultReproduction, neat.DefaultSpeciesSet, neat.DefaultStagnation
        return neat.Config(neat.DefaultGenome, *parts, str(path))


def fitness_of(trial: Trial) -> Callable[[list[tuple[int, Any]], Any], None]:
    """What evaluates all genomes of a generation at once, and offers the best."""
    recurrent = trial.task.name in NEEDS_MEMORY

    def evaluate(numbered: list[tuple[int, Any]], config: Any) -> None:
        genomes = [genome for _, genome in numbered]
        policy = Networks(genomes, config, recurrent)
        fitness = trial.returns(policy, len(genomes), EPISODES, common=False).mean(1).tolist()
        for genome, value in zip(genomes, fitness, strict=True):
            genome.fitness = value
        best = max(genomes, key=lambda genome: genome.fitness)
        trial.offer(player(Networks([best], config, recurrent)), best.fitness)

    return evaluate


def search(trial: Trial) -> None:
    """Go on until the best of a generation is good on fresh starts, too."""
    population = neat.Population(config_of(trial.task), seed=trial.seed)
    evaluate = fitness_of(trial)
    while trial.open:
        population.run(evaluate, 1)
