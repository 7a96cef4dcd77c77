"""Algorithm 3: running skills in an environment, which is a learned model or a world."""

from cgtorch.simulation.model import CompiledModels as CompiledModels
from cgtorch.simulation.model import ModelEnvironment as ModelEnvironment
from cgtorch.simulation.recording import Recording as Recording
from cgtorch.simulation.rollout import MAX_STEPS as MAX_STEPS
from cgtorch.simulation.rollout import MAX_TRANSITIONS as MAX_TRANSITIONS
from cgtorch.simulation.rollout import most_steps as most_steps
from cgtorch.simulation.rollout import rollout as rollout
from cgtorch.simulation.shared import shared_rollout as shared_rollout
from cgtorch.simulation.torch_engine import Rollouts as Rollouts
from cgtorch.simulation.tracing import Step as Step
from cgtorch.simulation.tracing import Traced as Traced
from cgtorch.simulation.tracing import traced as traced
