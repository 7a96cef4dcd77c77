"""Algorithm 2: evolving computational graphs, the whole population in batched tensors."""

from cgtorch.evolution.evolution import EvolutionSettings as EvolutionSettings
from cgtorch.evolution.evolution import EvolutionState as EvolutionState
from cgtorch.evolution.evolution import ask as ask
from cgtorch.evolution.evolution import initial_state as initial_state
from cgtorch.evolution.evolution import tell as tell
from cgtorch.evolution.fitness import Evaluation as Evaluation
from cgtorch.evolution.fitness import Evaluator as Evaluator
from cgtorch.evolution.fitness import Fitness as Fitness
from cgtorch.evolution.fitness import chance_of_success as chance_of_success
from cgtorch.evolution.fitness import episode_return as episode_return
from cgtorch.evolution.fitness import evaluator as evaluator
from cgtorch.evolution.islands import Island as Island
from cgtorch.evolution.offspring import mutate as mutate
from cgtorch.evolution.population import STRATEGY as STRATEGY
from cgtorch.evolution.population import Crossover as Crossover
from cgtorch.evolution.population import Mutation as Mutation
from cgtorch.evolution.population import Population as Population
from cgtorch.evolution.population import initial_strategy as initial_strategy
from cgtorch.evolution.population import join as join
from cgtorch.evolution.population import population_from as population_from
from cgtorch.evolution.search import Generation as Generation
from cgtorch.evolution.search import evolve as evolve
from cgtorch.evolution.selection import Selection as Selection
from cgtorch.evolution.selection import lexicase as lexicase
from cgtorch.evolution.selection import tournament as tournament
