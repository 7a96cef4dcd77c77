"""The actions of section VI: MoveBase, Detect and Grasp, and networks."""

from cgtorch.graphs import Action, ActionSet, BranchingNN, ContinuousNN, Perceive, Step, Test

MOTION = 3  # numbers of a motion: dx, dy (m), dθ (rad)
PERCEPT = 7  # numbers of the paper's percept


class MoveBase(Step):
    """Drive straight by dx and dy (m) in the base's frame, then turn by dθ (rad, to the left).

    Fails, and changes nothing, if something is in the way, or if there is no message.
    """

    native_kind, request = "STEP", "control"
    plain_module = "cgtorch.tabletop.plain_routines"

    def __init__(self) -> None:
        super().__init__(MOTION)


class Detect(Perceive):
    """Perceive again, as the paper's robot detects the table; always succeeds."""

    native_kind, request = "PERCEIVE", "perceive"
    plain_module = "cgtorch.tabletop.plain_routines"


class Grasp(Test):
    """Grasp the object; success ends the computation."""

    native_kind, request = "TEST", "test"
    plain_module = "cgtorch.tabletop.plain_routines"


def paper_actions(percept_size: int = PERCEPT) -> ActionSet:
    """The five actions of section VI, with networks for percepts of `percept_size` numbers."""
    networks = ContinuousNN(percept_size, outputs=MOTION), BranchingNN(percept_size)
    return named_actions(*networks)


def named_actions(*networks: Action) -> ActionSet:
    """The routines of section VI and the given networks, named by their classes."""
    actions = (MoveBase(), Detect(), Grasp(), *networks)
    return ActionSet(tuple(type(a).__name__ for a in actions), actions)
