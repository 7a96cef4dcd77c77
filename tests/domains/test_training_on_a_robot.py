"""A robot's run from Python: it is trained on, and goes on later."""

from pathlib import Path

from driven_cart import CartDriver

import cgtorch


def test_a_robot_is_trained_and_goes_on(tmp_path: Path) -> None:
    """The driver's class is the domain; its budget ends the run, which asks no more than that."""
    about = {"population": 40, "generations": 8, "practice": 4, "rounds": 1}
    run = cgtorch.train(
        CartDriver, tmp_path / "run", quiet=True, budget={"motions": 60, "tests": 60}, **about
    )
    first = [row for row in run.log() if row["event"] == "action"]
    assert 20 < len(first) <= 120
    again = run.resume(quiet=True, rounds=2, budget={"motions": 80, "tests": 80})
    later = [row for row in again.log() if row["event"] == "action"]
    assert later[: len(first)] == first
    assert len(first) <= len(later) <= 160
    assert len(again.stages) >= len(run.stages)
