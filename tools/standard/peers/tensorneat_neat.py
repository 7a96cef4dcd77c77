"""NEAT of TensorNEAT.

As in its example for CartPole-v1, examples/gymnax/cartpole.py: a population of 1,000, 20 species,
`BiasNode` with tanh and sums, and 5 episodes of each individual from starts of its own; where
controls are continuous their outputs go through tanh, as in its example
mountain_car_continuous.py. Its recurrent networks, `RecurrentGenome`, begin with each percept anew
and remember nothing from step to step, so tasks that need memory are left out. It is installed from
its repository, github.com/EMI-Group/tensorneat.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import torch
from tensorneat.algorithm.neat import NEAT
from tensorneat.common import ACT, AGG, State
from tensorneat.genome import BiasNode, DefaultGenome
from torch import Tensor

from standard.measure import Trial, player
from standard.peers import NEEDS_MEMORY, UnsuitableError
from standard.task import Task

POPULATION, EPISODES = 1000, 5


class Networks:
    """P individuals as a policy of lanes, B of each, which follow each other."""

    def __init__(self, forward: Any, state: Any, transformed: Any) -> None:
        """Individuals that `transform` has been applied to."""
        self.forward, self.state, self.transformed = forward, state, transformed
        self.individuals = len(jax.tree.leaves(transformed)[0])

    def __call__(self, percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        """See `Policy`."""
        seen = percept.numpy().reshape(self.individuals, -1, percept.shape[1])
        control = self.forward(self.state, self.transformed, seen)
        return torch.from_numpy(np.array(control)).flatten(0, 1), None


def algorithm_of(task: Task) -> Any:
    """The example's algorithm for a task."""
    genome = DefaultGenome(
        num_inputs=task.inputs,
        num_outputs=task.outputs,
        init_hidden_layers=(),
        node_gene=BiasNode(activation_options=ACT.tanh, aggregation_options=AGG.sum),
        output_transform=None if task.discrete else ACT.tanh,
    )
    return NEAT(
        pop_size=POPULATION,
        species_size=20,
        survival_threshold=0.1,
        compatibility_threshold=1.0,
        genome=genome,
    )


def search(trial: Trial) -> None:
    """Go on until the best of a generation is good on fresh starts, too."""
    if trial.task.name in NEEDS_MEMORY:
        raise UnsuitableError("its networks remember nothing")
    algorithm = algorithm_of(trial.task)
    state = algorithm.setup(State(randkey=jax.random.PRNGKey(trial.seed)))
    ask, tell = jax.jit(algorithm.ask), jax.jit(algorithm.tell)
    transform = jax.jit(jax.vmap(algorithm.transform, in_axes=(None, 0)))
    each = jax.vmap(algorithm.forward, in_axes=(None, None, 0))
    forward = jax.jit(jax.vmap(each, in_axes=(None, 0, 0)))
    with trial.compiling():
        population = transform(state, ask(state))
        tell(state, jnp.zeros(POPULATION))
        percept = torch.zeros(POPULATION * trial.starts(EPISODES), trial.task.inputs)
        live = torch.ones(len(percept), dtype=torch.bool)
        Networks(forward, state, population)(percept, None, live)
    while trial.open:
        population = transform(state, ask(state))
        policy = Networks(forward, state, population)
        fitness = trial.returns(policy, POPULATION, EPISODES, common=False).mean(1).float()
        best = int(fitness.argmax())
        champion = jax.tree.map(lambda x, best=best: x[best : best + 1], population)
        trial.offer(player(Networks(forward, state, champion)), float(fitness[best]))
        state = tell(state, jnp.asarray(fitness.numpy()))
