"""The small run that is trained once."""

import pytest
from trained import Trained, trained_run


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A run up to S1; its folder is not to be changed."""
    return trained_run(tmp_path_factory)
