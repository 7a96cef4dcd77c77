"""The tabletop's Γ and C: models with the known geometry of tables and grasps."""

from cgtorch.tabletop.models import geometry as geometry
from cgtorch.tabletop.models.success import GraspClassifier as GraspClassifier
from cgtorch.tabletop.models.transition import TableTransitionModel as TableTransitionModel
from cgtorch.tabletop.models.transition import compiled_models as compiled_models
