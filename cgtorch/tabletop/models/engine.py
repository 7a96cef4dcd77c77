"""The tabletop's models in the form of compiled rollouts."""

from cgtorch.native import alike, structure
from cgtorch.simulation import CompiledModels, ModelEnvironment
from cgtorch.tabletop.models.success import GraspClassifier
from cgtorch.tabletop.models.transition import TableTransitionModel
from cgtorch.tabletop.world.clear_motion import ClearMotion, body_structure


def compiled_models(e: ModelEnvironment) -> CompiledModels | None:
    """Γ, C and the check of motions for compiled rollouts, or None if they are not compiled."""
    gamma, classifier = getattr(e.gamma, "__self__", None), e.classifier
    if not (type(gamma) is TableTransitionModel and type(classifier) is GraspClassifier):
        return None
    if type(e.possible) is not ClearMotion or e.gamma != gamma.predict_with_novelty:
        return None
    percepts, footprint = e.percepts, e.possible.footprint
    first, second = gamma.compiled(percepts, percepts[:, :3]), classifier.compiled(percepts)
    if first is None or second is None or not alike(percepts, footprint) or e.control_size != 3:
        return None
    models = structure("TabletopModels", percepts.dtype)(
        gamma=first, classifier=second, body=body_structure(footprint)
    )
    return CompiledModels(
        "tabletop", percepts.dtype, models, ("DOMAIN_NN", "DOMAIN_OTHER_NN", "DOMAIN_BRANCHING")
    )
