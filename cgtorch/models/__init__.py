"""Kernel machines in torch, and the two models that evolving needs: Γ and C."""

from cgtorch.models import geometry as geometry
from cgtorch.models.compact import CompactReport as CompactReport
from cgtorch.models.compact import compact as compact
from cgtorch.models.compact import compact_success_classifier as compact_success_classifier
from cgtorch.models.compact import compact_transition_model as compact_transition_model
from cgtorch.models.grid_search import Choice as Choice
from cgtorch.models.grid_search import GridResult as GridResult
from cgtorch.models.grid_search import grid_search as grid_search
from cgtorch.models.learning_curve import LearningCurve as LearningCurve
from cgtorch.models.learning_curve import doubling_sizes as doubling_sizes
from cgtorch.models.learning_curve import learning_curve as learning_curve
from cgtorch.models.storage import load_model as load_model
from cgtorch.models.storage import load_report as load_report
from cgtorch.models.storage import save_model as save_model
from cgtorch.models.success import SuccessClassifier as SuccessClassifier
from cgtorch.models.success import SuccessReport as SuccessReport
from cgtorch.models.success import fit_success_classifier as fit_success_classifier
from cgtorch.models.svc import SVC as SVC
from cgtorch.models.svr import SVR as SVR
from cgtorch.models.transition import TransitionModel as TransitionModel
from cgtorch.models.transition_fit import TransitionReport as TransitionReport
from cgtorch.models.transition_fit import fit_transition_model as fit_transition_model
from cgtorch.models.transition_quality import TransitionQuality as TransitionQuality
from cgtorch.models.transition_quality import transition_quality as transition_quality
from cgtorch.models.update import update_success_classifier as update_success_classifier
from cgtorch.models.update import update_transition_model as update_transition_model
