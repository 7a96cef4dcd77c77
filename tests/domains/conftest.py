"""Models of a small tabletop."""

import pytest
from reaching import small_knowledge, small_setup

from cgtorch.domains.knowledge import Knowledge
from cgtorch.improvement.setup import Setup


@pytest.fixture(scope="session")
def knowledge() -> Knowledge:
    return small_knowledge()


@pytest.fixture
def setup() -> Setup:
    return small_setup()
