import torch

from cgtorch.evolution import lexicase
from cgtorch.runs.settings import RunSettings
from cgtorch.training.train import evolution_of


def test_only_the_method_of_the_paper_selects_by_tournament() -> None:
    assert evolution_of(RunSettings(population=30)).population == 30
    assert evolution_of(RunSettings()).selection is lexicase
    paper = evolution_of(RunSettings(method="paper", tournament=1000, population=30))
    assert paper.population == 30
    scores = torch.tensor([[9.0], [0.0], [0.0]])  # which a tournament does not look at
    generator = torch.Generator().manual_seed(0)
    chosen = paper.selection(torch.tensor([2, 0, 1]), scores, 50, generator)
    assert (chosen == 2).all()
