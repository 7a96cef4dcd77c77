"""A small search in models that were really fitted to a world with a stand-in for the arms."""

import pytest
from imagining import EARLIER, Beginning, search_of
from reaching import small_knowledge, small_setup
from support import seeded

from cgtorch.domains.knowledge import Knowledge
from cgtorch.improvement.events import Event
from cgtorch.improvement.imagined_state import CURIOUS, State
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.tabletop.world import Scenarios, stage_scenarios


@pytest.fixture(scope="session")
def knowledge() -> Knowledge:
    return small_knowledge()


@pytest.fixture
def setup() -> Setup[Scenarios]:
    return small_setup()


@pytest.fixture
def nothing_yet(knowledge: Knowledge) -> Progress[Scenarios]:
    """Before the first stage."""
    none = stage_scenarios("near", 0)
    return Progress(None, none, none, knowledge)


@pytest.fixture(scope="session")
def beginning() -> Beginning:
    told: list[Event] = []
    search = search_of(told=told)
    search.setup.purse.add(CURIOUS, EARLIER)
    return search, search.begun(seeded(0)), told


@pytest.fixture
def begun(beginning: Beginning) -> State:
    return beginning[1]
