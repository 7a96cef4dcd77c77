import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.errors import SettingsError
from cgtorch.evolution.selection import ranked, ranking, tournament


@given(st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0]), st.integers(1, 3)), min_size=1))
def test_ranking_is_by_fitness_then_size_then_place(pairs: list[tuple[float, int]]) -> None:
    fitness, size = (torch.tensor(x) for x in zip(*pairs, strict=True))
    wanted = sorted(range(len(pairs)), key=lambda i: (-pairs[i][0], pairs[i][1], i))
    assert ranking(fitness, size).tolist() == wanted


numbers = st.one_of(
    st.floats(allow_nan=False, width=32), st.sampled_from([0.0, -0.0, 0.5, 1e-45, 3.4e38])
)


@given(
    st.lists(st.tuples(numbers, st.integers(0, 2**40)), min_size=1, max_size=50),
    st.sampled_from([torch.float32, torch.float64]),
)
def test_ranking_compiled_and_in_torch(pairs: list[tuple[float, int]], dtype: torch.dtype) -> None:
    values, sizes = zip(*pairs, strict=True)
    fitness, size = torch.tensor(values, dtype=dtype), torch.tensor(sizes)
    assert torch.equal(ranking(fitness, size), ranked(fitness, size))


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
