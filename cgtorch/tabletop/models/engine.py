"""The tabletop's models as compiled rollouts know them."""

from torch import Tensor

from cgtorch.native.structures import MOST_PERCEPT, structures, suits
from cgtorch.simulation import ModelEnvironment
from cgtorch.svm.compiled import Compiled
from cgtorch.tabletop.models.success import GraspClassifier
from cgtorch.tabletop.models.transition import TableTransitionModel
from cgtorch.tabletop.world.clear_way import ClearWay, body_structure


def compiled_models(e: ModelEnvironment) -> Compiled | None:
    """Γ, C, errors and first percepts for compiled rollouts, if these are models it knows."""
    gamma, classifier = getattr(e.gamma, "__self__", None), e.classifier
    if not (type(gamma) is TableTransitionModel and type(classifier) is GraspClassifier):
        return None
    if type(e.possible) is not ClearWay or e.gamma != gamma.predict_with_novelty:
        return None
    percepts, footprint = e.percepts.contiguous(), e.possible.footprint
    errors = None if e.errors is None else e.errors.contiguous()
    given: list[Tensor] = [percepts, e.first_state, footprint]
    given += [] if errors is None else [errors]
    if not suits(*given) or e.control_size != 3 or percepts.shape[1] > MOST_PERCEPT:
        return None
    first, second = gamma.compiled(percepts, percepts[:, :3]), classifier.compiled(percepts)
    if first is None or second is None:
        return None
    structure = structures(percepts.dtype).Models(
        first.structure, second.structure, body_structure(footprint),
        percepts.data_ptr(), e.first_state.data_ptr(),
        None if errors is None else errors.data_ptr(),
        percepts.shape[1], 1 if errors is None else errors.shape[1], e.most_novel,
    )  # fmt: skip
    return Compiled(structure, (*given, *first.kept, *second.kept))
