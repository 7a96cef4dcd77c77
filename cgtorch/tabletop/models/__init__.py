"""The tabletop's Γ and C: the known geometry, and the quality of both models."""

from cgtorch.tabletop.models import geometry as geometry
from cgtorch.tabletop.models.success import GraspClassifier as GraspClassifier
from cgtorch.tabletop.models.success_quality import SuccessQuality as SuccessQuality
from cgtorch.tabletop.models.success_quality import fresh_labels as fresh_labels
from cgtorch.tabletop.models.success_quality import success_quality as success_quality
from cgtorch.tabletop.models.transition import TableTransitionModel as TableTransitionModel
from cgtorch.tabletop.models.transition_quality import TransitionQuality as TransitionQuality
from cgtorch.tabletop.models.transition_quality import transition_quality as transition_quality
