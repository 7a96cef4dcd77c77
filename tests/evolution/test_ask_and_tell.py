"""A search as an object is the search of the functions, also after it was on disk."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from support import same, same_individuals, seeded
from torch import Tensor

from cgtorch.evolution import EvolutionSettings, ask, initial_state, tell
from cgtorch.evolution.ask_and_tell import Search
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.errors import DataError, RunError, SettingsError
from cgtorch.ground.files import notes_of
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
    search.tell([*range(len(search.ask()))])
    search.tell([3] * len(search.ask()))
    assert search.best_fitness == 11


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    search = Search(ACTIONS, population=12)
    search.save(tmp_path / "a")
    whole = (tmp_path / "a").read_bytes()
    tensors, notes = safetensors.torch.load(whole), notes_of(whole)
    wrong = {"cut": whole[:-100], "json": b'{"format": "cgtorch-skill"}'}
    wrong["others"] = safetensors.torch.save({"weights": torch.zeros(3)})
    wrong["untold"] = safetensors.torch.save(tensors)
    for generation in (-1.0, 2.0**53, torch.nan):
        numbers = torch.tensor([generation, 0.0], dtype=torch.float64)
        wrong[f"{generation}"] = safetensors.torch.save({**tensors, "numbers": numbers}, notes)
    for name, data in wrong.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(
            RunError, match=rf"{name}' holds no whole search \(.*\); give a file that"
        ):
            Search.load(tmp_path / name, ACTIONS, population=12)
    with pytest.raises(RunError, match="none"):
        Search.load(tmp_path / "none", ACTIONS, population=12)


@pytest.mark.parametrize(
    ("now", "message"),
    [
        ({"population": 30}, "a' is a search with population 12, not 30; give the same as when it"),
        ({}, "population 12, not 400"),
        ({"population": 12, "capacity": 20}, "capacity 24, not 20"),
        ({"population": 12, "initial_nodes": (2, 12)}, r"initial_nodes \[4, 12\], not \[2, 12\]"),
    ],
)
def test_a_search_goes_on_with_its_own_settings_only(
    now: dict[str, Any], message: str, tmp_path: Path
) -> None:
    Search(ACTIONS, population=12).save(tmp_path / "a")
    with pytest.raises(SettingsError, match=message):
        Search.load(tmp_path / "a", ACTIONS, **now)


def test_a_search_goes_on_with_its_own_actions_only(tmp_path: Path) -> None:
    Search(ACTIONS, population=12).save(tmp_path / "a")
    others = ActionSet(ACTIONS.names[::-1], ACTIONS.actions[::-1])
    with pytest.raises(SettingsError, match=r"a' is a search with actions \['MoveBase'.*, not \["):
        Search.load(tmp_path / "a", others, population=12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"population": 1}, "population is 1; give a whole number from 2 to"),
        ({"population": "60"}, "population is '60'; give a whole number"),
        ({"population": 60.0}, "population is 60.0; give a whole number"),
        ({"popluation": 60}, "unknown setting 'popluation'; did you mean 'population'"),
        ({"capacity": "x"}, "capacity is 'x'; give a whole number"),
        ({"initial_nodes": 5}, "initial nodes are 5; give two whole numbers"),
        ({"fitness": "high"}, "fitness is 'high'; give a function"),
        ({"tau": "x"}, "tau is 'x'; give a finite variance"),
        ({"seed": 1.5}, "seed is 1.5; give a whole number of at most 64 bits"),
        ({"seed": "a"}, "seed is 'a'; give a whole number"),
        ({"seed": None}, "seed is None; give a whole number"),
        ({"seed": 2**70}, "seed is 1180591620717411303424; give a whole number"),
        ({"seeds": 5}, "seeds is 5; give a Population"),
        ({"actions": None}, "actions is None; give an ActionSet, such as domain.actions()"),
        ({"actions": "tabletop"}, "actions is 'tabletop'; give an ActionSet"),
    ],
)
def test_what_cannot_begin_a_search_is_one_error(given: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(message)):
        Search(**{"actions": ACTIONS, "population": 12, **given})


def test_numbers_of_numpy_are_settings_too() -> None:
    search = Search(ACTIONS, population=np.int64(12), seed=np.int32(3), tau=np.float64(0.1))
    assert type(search.settings.population) is int
    assert type(EvolutionSettings(population=np.int64(12)).population) is int
    assert type(search.skill("a", np.int64(5)).max_transitions) is int
    assert same(search.ask(), Search(ACTIONS, population=12, seed=3, tau=0.1).ask())


VALUES = torch.rand(12, generator=seeded(0))


@pytest.mark.parametrize(
    ("told", "message"),
    [
        (([1.0, 2.0],), "give a tensor (12,), one number for each individual"),
        ((None,), "fitness is None; give a dense tensor or a list of numbers"),
        (("abc",), "fitness is 'abc'; give a dense tensor or a list of numbers"),
        ((["a"] * 12,), "fitness is ['a', "),
        (({0: 1.0},), "fitness is {0: 1.0}; give a dense tensor or a list of numbers"),
        ((torch.rand(12, device="meta"),), "fitness is tensor("),
        ((VALUES.to_sparse(),), "give a dense tensor or a list of numbers"),
        (([10**400] * 12,), "give a dense tensor or a list of numbers"),
        ((torch.complex(VALUES, VALUES),), "fitness is a tensor (12,) of complex64; give real"),
        ((VALUES, "x"), "scores are 'x'; give a dense tensor or a list of numbers"),
        ((VALUES, [None] * 12), "scores are [None, "),
        ((VALUES, torch.complex(VALUES, VALUES)[:, None]), "of complex64; give real numbers"),
        ((VALUES, [[1.0, 2.0]] * 11), "scores are a tensor (11, 2)"),
    ],
)
def test_what_is_no_fitness_is_one_error(told: tuple[Any, ...], message: str) -> None:
    search = Search(ACTIONS, population=12)
    search.ask()
    with pytest.raises(DataError, match=re.escape(message)):
        search.tell(*told)
    assert search.generation == 0


def test_nothing_is_told_that_nobody_has_asked_for(tmp_path: Path) -> None:
    search = Search(ACTIONS, population=12)
    for generation in range(2):
        with pytest.raises(DataError, match=f"of generation {generation}, which nobody has asked"):
            search.tell(VALUES)
        search.ask()
        search.save(tmp_path / "a")
        Search.load(tmp_path / "a", ACTIONS, population=12).tell(VALUES)
        search.tell(VALUES)


def test_scores_may_be_a_list() -> None:
    one, other = (Search(ACTIONS, population=12) for _ in range(2))
    scores = torch.rand(12, 3, generator=seeded(1))
    assert same(one.ask(), other.ask())
    one.tell(VALUES, scores)
    other.tell(VALUES.tolist(), scores.tolist())
    assert same(one.ask(), other.ask())


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ((None,), "the name of a skill is None; give a text"),
        (("a", -1), "max_transitions is -1; give a whole number from 1 to"),
        (("a", "x"), "max_transitions is 'x'; give a whole number"),
    ],
)
def test_what_cannot_be_a_skill_is_one_error(about: tuple[Any, ...], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Search(ACTIONS, population=12).skill(*about)
