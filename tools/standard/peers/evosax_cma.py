"""CMA-ES of evosax.

As in its example examples/02_rl.ipynb: a population of 128, 16 rollouts of each individual, which
all meet the same starts, new ones in each generation, percepts normalised by the mean and standard
deviation of all that were seen in earlier generations, and its `MLP` with tanh between layers, and
behind the last of them where controls are continuous. The example's algorithm is SNES; CMA-ES takes
its place with its default parameters, and one hidden layer of 16 that of the example's two of 64,
as CMA-ES holds a matrix of the weights. Where memory is needed the hidden layer is flax's
`SimpleCell` with 8 units, which is Elman's network.
"""

from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import torch
from evosax.algorithms import CMA_ES
from evosax.problems.networks import MLP, identity_output_fn, tanh_output_fn
from flax import linen as nn
from torch import Tensor

from standard.measure import Trial, player
from standard.peers import NEEDS_MEMORY
from standard.task import Task

POPULATION, ROLLOUTS, HIDDEN, UNITS = 128, 16, 16, 8


class Elman(nn.Module):
    """A recurrent hidden layer, and a linear output."""

    outputs: int
    output: Any

    @nn.compact
    def __call__(self, carry: jax.Array, percept: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The next carry (..., 8), and the output."""
        carry, hidden = nn.SimpleCell(UNITS)(carry, percept)
        return carry, self.output(nn.Dense(self.outputs)(hidden))


class Feedforward(nn.Module):
    """A network of evosax, with a carry that nothing is done with."""

    outputs: int
    output: Any

    @nn.compact
    def __call__(self, carry: jax.Array, percept: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The same carry, and the output."""
        network = MLP(layer_sizes=(HIDDEN, self.outputs), output_fn=self.output)
        return carry, network(percept)


class Seen:
    """Sums over percepts (n, D), of which the mean and the standard deviation follow."""

    def __init__(self, inputs: int) -> None:
        """Nothing is seen yet."""
        self.count, self.sums = 0, torch.zeros(2, inputs, dtype=torch.float64)

    def add(self, percept: Tensor) -> None:
        """Some more."""
        self.count += len(percept)
        self.sums += torch.stack([percept.sum(0), (percept * percept).sum(0)])

    def scaling(self) -> tuple[Tensor, Tensor]:
        """The mean (D,) and the standard deviation (D,)."""
        mean, square = self.sums / max(1, self.count)
        deviation = (square - mean * mean).clamp_min(0).sqrt().clamp(1e-6, 1e6)
        return mean.float(), deviation.float() if self.count else torch.ones(len(mean))


class Networks:
    """P individuals as a policy of lanes, B of each, which follow each other."""

    def __init__(self, forward: Any, parameters: Any, scaling: Any, seen: Any = None) -> None:
        """The networks with these parameters (P, ...), and where to note what is seen."""
        self.forward, self.parameters = forward, parameters
        self.scaling, self.seen = scaling, seen
        self.individuals = len(jax.tree.leaves(parameters)[0])

    def __call__(self, percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        """See `Policy`."""
        shape = self.individuals, len(percept) // self.individuals
        if memory is None:
            memory = jnp.zeros((*shape, UNITS))
        if self.seen is not None:
            self.seen.add(percept[live])
        scaled = (percept - self.scaling[0]) / self.scaling[1]
        given = scaled.numpy().reshape(*shape, -1)
        memory, control = self.forward(self.parameters, memory, given)
        return torch.from_numpy(np.array(control)).flatten(0, 1), memory


def network_of(task: Task, key: jax.Array) -> tuple[Any, Any]:
    """What computes outputs of P individuals with B lanes each, and parameters of one."""
    output = identity_output_fn if task.discrete else tanh_output_fn
    network = (Elman if task.name in NEEDS_MEMORY else Feedforward)(task.outputs, output)
    parameters = network.init(key, jnp.zeros((1, UNITS)), jnp.zeros((1, task.inputs)))
    return jax.jit(jax.vmap(network.apply)), parameters


def search(trial: Trial) -> None:
    """Go on until the best of a generation is good on fresh starts, too."""
    key, own = jax.random.split(jax.random.key(trial.seed))
    seen = Seen(trial.task.inputs)
    with trial.compiling():
        forward, first = network_of(trial.task, own)
        algorithm = CMA_ES(population_size=POPULATION, solution=first)
        settings = algorithm.default_params
        state = algorithm.init(own, first, settings)
        population, asked = algorithm.ask(own, state, settings)
        algorithm.tell(own, population, jnp.zeros(POPULATION), asked, settings)
        _try(trial, Networks(forward, population, seen.scaling()))
    while trial.open:
        key, asking, telling = jax.random.split(key, 3)
        population, state = algorithm.ask(asking, state, settings)
        scaling = seen.scaling()
        policy = Networks(forward, population, scaling, seen)
        fitness = trial.returns(policy, POPULATION, ROLLOUTS).mean(1).float()
        costs = jnp.asarray(-fitness.numpy())
        state, _ = algorithm.tell(telling, population, costs, state, settings)
        best = int(fitness.argmax())
        parameters = jax.tree.map(itemgetter(slice(best, best + 1)), population)
        trial.offer(player(Networks(forward, parameters, scaling)), float(fitness[best]))


def _try(trial: Trial, policy: Networks) -> None:
    """Call once what is compiled when it is called first."""
    percept = torch.zeros(POPULATION * trial.starts(ROLLOUTS), trial.task.inputs)
    policy(percept, None, torch.ones(len(percept), dtype=torch.bool))
