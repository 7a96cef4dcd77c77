"""The tabletop's models as compiled rollouts know them."""

from typing import Any

from cgtorch.native import structure, suits
from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.models.success import GraspClassifier
from cgtorch.tabletop.models.transition import TableTransitionModel
from cgtorch.tabletop.world.clear_way import ClearWay, body_structure


def compiled_models(e: ModelEnvironment) -> Any:
    """Γ, C, errors and first percepts for compiled rollouts, or None if C does not know these."""
    gamma, classifier = getattr(e.gamma, "__self__", None), e.classifier
    if not (type(gamma) is TableTransitionModel and type(classifier) is GraspClassifier):
        return None
    if type(e.possible) is not ClearWay or e.gamma != gamma.predict_with_novelty:
        return None
    percepts, errors, footprint = e.percepts, e.errors, e.possible.footprint
    given = [percepts, e.first_state, footprint, *([] if errors is None else [errors])]
    first, second = gamma.compiled(percepts, percepts[:, :3]), classifier.compiled(percepts)
    if first is None or second is None or not suits(*given) or e.control_size != 3:
        return None
    return structure("Models", percepts.dtype)(
        gamma=first, classifier=second, body=body_structure(footprint), percepts=percepts,
        state=e.first_state, errors=errors, size=percepts.shape[1],
        turns=1 if errors is None else errors.shape[1], most_novel=e.most_novel,
    )  # fmt: skip
