"""Kernel machines in torch, as exact as libsvm: SVC, SVR, grid search, updates, storage."""

from cgtorch.svm import inputs as inputs
from cgtorch.svm.cross_validation import LearningCurve as LearningCurve
from cgtorch.svm.cross_validation import doubling_sizes as doubling_sizes
from cgtorch.svm.cross_validation import learning_values as learning_values
from cgtorch.svm.grid_search import Choice as Choice
from cgtorch.svm.grid_search import grid_search as grid_search
from cgtorch.svm.machine import SVC as SVC
from cgtorch.svm.machine import SVR as SVR
from cgtorch.svm.reduced_set import fit_reduced_set as fit_reduced_set
from cgtorch.svm.storage import load_model as load_model
from cgtorch.svm.storage import load_model_and_report as load_model_and_report
from cgtorch.svm.storage import save_model as save_model
