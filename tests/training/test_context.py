"""What improvement and evolution get of a run's settings."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from reaching import TABLE
from support import seeded
from walking import Walking

from cgtorch.evolution import EvolutionSettings, lexicase
from cgtorch.ground.asked import Purse
from cgtorch.improvement.events import Event
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training.context import Training, evolution_settings

RUN = StoredRun(Path("none"), RunSettings(), TABLE, paper_actions())


def ignore(event: Event) -> None:
    """Nobody watches."""


def training_of(run: StoredRun, purse: Purse | None = None) -> Training:
    return Training(run, ignore, lambda message: nullcontext(), purse=purse or Purse())


@pytest.mark.parametrize(
    ("repeats", "chosen", "stage", "rounds"),
    [(True, 0, 150, 150), (False, 0, 10, 20), (True, 7, 7, 7), (False, 7, 7, 7)],
)
def test_so_many_fresh_scenarios_are_to_be_solved_in_a_row(
    repeats: bool, chosen: int, stage: int, rounds: int
) -> None:
    run = replace(RUN, settings=RunSettings(practice=chosen), repeats=repeats)
    training = training_of(run)
    assert [training.practice(name) for name in ("S0", "S3", "auto-1")] == [stage, stage, rounds]
    for name in ("S0", "auto-1"):
        assert training.setup(name).practice == training.practice(name)
        assert training.setup(name).repeats == repeats


@pytest.mark.parametrize("chosen", [0, 7])
def test_with_rewards_there_is_no_practice(chosen: int) -> None:
    """Rounds try skills on fresh episodes by themselves."""
    domain = Walking()
    run = StoredRun(Path("none"), RunSettings(practice=chosen), domain, domain.actions())
    setup = training_of(run).setup("auto-1")
    assert (setup.practice, setup.looks) == (0, 0)


def test_the_smallest_return_that_counts_is_a_share_of_the_target() -> None:
    class Tiny(Walking):
        target_return = -1e-12

    for domain, least in ((TABLE, 1e-3), (Walking(), 1e-3), (Tiny(), 1e-15)):
        run = StoredRun(Path("none"), RunSettings(), domain, domain.actions())
        assert training_of(run).setup("auto-1").budget.least == pytest.approx(least)


def test_all_that_is_asked_is_paid_from_one_purse() -> None:
    training = training_of(RUN, Purse({"motions": 3}))
    assert training.setup("S0").purse is training.purse


def test_only_the_method_of_the_paper_selects_by_tournament() -> None:
    def evolution_of(**values: Any) -> EvolutionSettings:
        return evolution_settings(replace(RUN, settings=RunSettings(**values)))

    assert evolution_of(population=30).population == 30
    assert evolution_of().selection is lexicase
    paper = evolution_of(method="paper", tournament=1000, population=30)
    assert paper.population == 30
    scores = torch.tensor([[9.0], [0.0], [0.0]])  # which a tournament does not look at
    assert (paper.selection(torch.tensor([2, 0, 1]), scores, 50, seeded(0)) == 2).all()
