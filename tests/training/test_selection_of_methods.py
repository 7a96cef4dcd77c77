from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from reaching import TABLE

from cgtorch.evolution import EvolutionSettings, lexicase
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training.context import evolution_settings

RUN = StoredRun(Path("none"), RunSettings(), TABLE, paper_actions())


def evolution_of(**values: Any) -> EvolutionSettings:
    return evolution_settings(replace(RUN, settings=RunSettings(**values)))


def test_only_the_method_of_the_paper_selects_by_tournament() -> None:
    assert evolution_of(population=30).population == 30
    assert evolution_of().selection is lexicase
    paper = evolution_of(method="paper", tournament=1000, population=30)
    assert paper.population == 30
    scores = torch.tensor([[9.0], [0.0], [0.0]])  # which a tournament does not look at
    generator = torch.Generator().manual_seed(0)
    chosen = paper.selection(torch.tensor([2, 0, 1]), scores, 50, generator)
    assert (chosen == 2).all()
