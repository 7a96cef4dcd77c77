"""Models of a small tabletop and of the rail."""

import pytest
from rail import Cart, driven
from reaching import small_knowledge
from support import models_of

from cgtorch.domains.knowledge import Knowledge


@pytest.fixture(scope="session")
def knowledge() -> Knowledge:
    return small_knowledge()


@pytest.fixture(scope="session")
def known() -> Knowledge:
    """What is known of the rail after 300 transitions and as many tests."""
    return models_of(Cart()).fit(driven(300, 300, 0), 0)
