"""What a lane costs decides how a search divides what it plays."""

from lottery import Lottery, tickets
from support import seeded

from cgtorch.improvement.pace import BY_ROLLOUT, BY_STEP, pace_of


class Few(Lottery):
    """One that runs a few lanes at once."""

    most_lanes = 4


class Compared(Lottery):
    """One that others play, too."""

    frugal = True


class Uncounted(Lottery):
    """One that says that its steps do not count."""

    frugal = False


def test_environments_that_run_few_lanes_or_are_compared_by_steps_cost_by_the_step() -> None:
    assert pace_of(Few(tickets(1, seeded(0)))) is BY_STEP
    assert pace_of(Compared(tickets(1, seeded(0)))) is BY_STEP
    assert pace_of(Uncounted(tickets(1, seeded(0)))) is BY_ROLLOUT
    assert pace_of(Lottery(tickets(1, seeded(0)))) is BY_ROLLOUT
