import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch.evolution.selection import ranked, ranking, tournament
from cgtorch.graphs import NO_NODE, Graphs
from cgtorch.ground.errors import SettingsError


def of_sizes(sizes: Tensor) -> Graphs:
    """Graphs of so many nodes each, which lie in the last slots and lead nowhere."""
    most = int(sizes.max()) + 1
    action = torch.where(torch.arange(most) >= most - sizes[:, None], 0, NO_NODE)
    edges = torch.full((len(sizes), most, 1), NO_NODE)
    start = torch.full((len(sizes),), most - 1)
    return Graphs(action, edges, torch.zeros(len(sizes), most, 1), start)


@given(st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0]), st.integers(1, 3)), min_size=1))
def test_ranking_is_by_fitness_then_size_then_place(pairs: list[tuple[float, int]]) -> None:
    fitness, size = (torch.tensor(x) for x in zip(*pairs, strict=True))
    graphs = of_sizes(size)
    wanted = sorted(range(len(pairs)), key=lambda i: (-pairs[i][0], pairs[i][1], i))
    assert ranking(fitness, graphs).tolist() == wanted


numbers = st.one_of(
    st.floats(allow_nan=False, width=32), st.sampled_from([0.0, -0.0, 0.5, 1e-45, 3.4e38])
)


@given(
    st.lists(st.tuples(numbers, st.integers(0, 70)), min_size=1, max_size=50),
    st.sampled_from([torch.float32, torch.float64]),
)
def test_ranking_compiled_and_in_torch(pairs: list[tuple[float, int]], dtype: torch.dtype) -> None:
    values, sizes = zip(*pairs, strict=True)
    fitness, graphs = torch.tensor(values, dtype=dtype), of_sizes(torch.tensor(sizes))
    assert torch.equal(ranking(fitness, graphs), ranked(fitness, graphs))


@pytest.mark.parametrize("rounds", [1, 2, 5])
def test_tournament_pressure(rounds: int) -> None:
    """The best of t draws from P is within the best r with probability 1 - (1 - r/P)^t."""
    order = torch.randperm(20, generator=seeded(0))
    winners = tournament(rounds)(order, torch.zeros(20, 1), 40_000, seeded(1))
    place = torch.argsort(order)[winners]
    for r in range(1, 20):
        wanted = 1 - (1 - r / 20) ** rounds
        assert (place < r).float().mean().item() == pytest.approx(wanted, abs=0.013)


def test_a_tournament_needs_somebody() -> None:
    with pytest.raises(SettingsError, match="tournament is 0; give at least 1"):
        tournament(0)
