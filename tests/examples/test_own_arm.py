"""The example of an arm of one's own is trained, tried and described as the page says."""

from pathlib import Path

import numpy as np
import pytest

from cgtorch.domains.registry import make_domain
from cgtorch.ground.errors import DomainError
from cgtorch.training.run import open_run, train
from examples.own_arm import Gantry, GantrySettings, TableSimulator

NAME = "examples.own_arm:Gantry"


def test_the_arm_learns_to_push(tmp_path: Path) -> None:
    run = train(NAME, tmp_path / "run", population=12, practice=10, quiet=True)
    assert run.stages == ("01-push",)
    assert open_run(run.folder, NAME).evaluate(20, seed=1).successes >= 16
    asked = run.results[-1]["asked"]["search"]
    assert 0 < asked["simulated"] <= asked["steps"]


def test_the_stranger_is_asked_as_any_simulator() -> None:
    simulator = TableSimulator("push", 100)
    row = simulator.start(3)
    puck, goal = (simulator.table.data.body("puck").xpos, simulator.table.data.site("goal").xpos)
    assert np.allclose(simulator.table.observed()[3:], [*puck, *goal])
    control = np.array([0.1, 0.1, 0.1, 1.0, 40, 1.0, 0.01])
    once = simulator.run(row, 3, control)
    assert np.abs(simulator.hand() - control[:3]).max() < 0.02
    simulator.run(simulator.start(4), 4, control)
    assert np.array_equal(TableSimulator("push", 100).run(row, 3, control), once)


def test_there_is_one_task() -> None:
    assert make_domain(NAME).kinds == ("push",)
    with pytest.raises(DomainError, match="no task 'pull'; give push"):
        Gantry(GantrySettings(environment="pull"))
