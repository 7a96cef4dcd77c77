"""A search as an object is the search of the functions, also after it was on disk."""

from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch
from support import same, same_individuals, seeded
from torch import Tensor

from cgtorch.evolution import EvolutionSettings, ask, initial_state, tell
from cgtorch.evolution.ask_and_tell import Search
from cgtorch.graphs import Graphs
from cgtorch.ground.errors import DataError, RunError, SettingsError
from cgtorch.tabletop.actions import paper_actions

ACTIONS = paper_actions()


def worth(graphs: Graphs) -> Tensor:
    """Many nodes, and parameters near 1."""
    return graphs.num_nodes - (graphs.parameters - 1).abs().flatten(1).mean(1)


@pytest.mark.parametrize("more", [{}, {"lineages": 2}, {"elite": 3}])
def test_it_is_the_search_of_the_functions(more: dict[str, Any]) -> None:
    search = Search(ACTIONS, seed=4, population=20, **more)
    settings, generator = EvolutionSettings(population=20, **more), seeded(4)
    state = initial_state(settings, ACTIONS, generator)
    best = float("-inf")
    for number in range(6):
        assert search.generation == state.generation == number
        graphs = search.ask()
        assert same(graphs, ask(state).graphs)
        fitness = worth(graphs)
        search.tell(fitness.tolist())
        state = tell(state, fitness, settings, ACTIONS, generator)
        best = max(best, state.best_fitness)
        assert search.best_fitness == best
    assert search.skill("best").num_nodes <= int(search.best.graphs.num_nodes)


@pytest.mark.parametrize("more", [{}, {"lineages": 2}])
@pytest.mark.parametrize("told", [0, 1, 5])
def test_on_disk_and_back_it_goes_on_with_the_same_bits(
    told: int, more: dict[str, Any], tmp_path: Path
) -> None:
    about = {"population": 12, **more}
    search = Search(ACTIONS, seed=1, **about)
    for _ in range(told):
        search.tell(worth(search.ask()))
    search.save(tmp_path / "search.safetensors")
    again = Search.load(tmp_path / "search.safetensors", ACTIONS, **about)
    assert (again.generation, again.best_fitness) == (search.generation, search.best_fitness)
    assert same_individuals(again.best, search.best)
    for _ in range(4):
        fitness = worth(search.ask())
        assert torch.equal(fitness, worth(again.ask()))
        search.tell(fitness)
        again.tell(fitness)
    assert same_individuals(again.best, search.best)


def test_whole_numbers_are_a_fitness_too() -> None:
    search = Search(ACTIONS, population=12, lineages=2)
    search.tell(list(range(12)))
    search.tell([3] * len(search.ask()))
    assert search.best_fitness == 11


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    search = Search(ACTIONS, population=12)
    search.save(tmp_path / "a")
    (tmp_path / "b").write_bytes((tmp_path / "a").read_bytes()[:-100])
    with pytest.raises(RunError, match="damaged"):
        Search.load(tmp_path / "b", ACTIONS, population=12)
    tensors = safetensors.torch.load_file(tmp_path / "a")
    for generation in (-1.0, 2.0**53, torch.nan):
        numbers = torch.tensor([generation, 0.0], dtype=torch.float64)
        safetensors.torch.save_file({**tensors, "numbers": numbers}, tmp_path / "c")
        with pytest.raises(RunError, match=r"c' has had .* generations; it is damaged"):
            Search.load(tmp_path / "c", ACTIONS, population=12)
    with pytest.raises(RunError, match="none"):
        Search.load(tmp_path / "none", ACTIONS, population=12)
    with pytest.raises(DataError, match=r"give a tensor \(12,\)"):
        search.tell([1.0, 2.0])
    with pytest.raises(SettingsError, match="population is 1"):
        Search(ACTIONS, population=1)
