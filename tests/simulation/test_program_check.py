"""Graphs with numbers that stand for nothing are refused at the door, compiled or not."""

import sys
from dataclasses import replace

import pytest
import torch
from random_models import random_models
from support import as_double, as_double_actions
from torch import Tensor

from cgtorch.evolution import evaluator
from cgtorch.evolution.population import random_population
from cgtorch.graphs import Graphs
from cgtorch.ground.errors import GraphError
from cgtorch.simulation import compiled as engine
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import paper_actions

ACTIONS = as_double_actions(paper_actions())


def graphs() -> Graphs:
    generator = torch.Generator().manual_seed(0)
    return random_population(300, ACTIONS, 8, (2, 6), generator).graphs


def changed(tensor: Tensor, place: tuple[int, ...], value: int) -> Tensor:
    tensor = tensor.clone()
    tensor[place] = value
    return tensor


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    ("name", "place", "value", "said"),
    [
        ("action", (290, 0), 5, "graph 290 has action 5; give -1 to 4"),
        ("action", (3, 1), -2, "graph 3 has action -2"),
        ("edges", (7, 0, 1), 8, "graph 7 has head 8; give -1 to 7"),
        ("edges", (0, 7, 0), -(2**62), f"graph 0 has head {-(2**62)}"),
        ("start", (299,), 8, "graph 299 has start 8; give 0 to 7"),
        ("start", (1,), -1, "graph 1 has start -1"),
    ],
)
def test_it_says_which_number_of_which_graph(
    compiled: bool,
    name: str,
    place: tuple[int, ...],
    value: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not compiled:
        monkeypatch.setattr(engine, "constants", lambda *_: {})
        resumable = sys.modules["cgtorch.simulation.rollout"]
        monkeypatch.setattr(resumable, "resumable_rollout", lambda *_: None)
    whole, environment = as_double(graphs()), random_models(0, 3)
    keep = torch.tensor([True, False, False])
    rollout(whole, ACTIONS, environment)
    evaluator(ACTIONS, environment, keep)(whole)
    wrong = replace(whole, **{name: changed(getattr(whole, name), place, value)})
    with pytest.raises(GraphError, match=said):
        rollout(wrong, ACTIONS, environment)
    with pytest.raises(GraphError, match=said):
        evaluator(ACTIONS, environment, keep)(wrong)
