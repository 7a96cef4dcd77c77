import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.viewer.choice import FROM_EDGE, put_object, scenario_of
from cgtorch.tabletop.world import draw_of
from cgtorch.tabletop.world.general import DRAWS
from cgtorch.tabletop.world.geometry import rotate


@pytest.mark.parametrize("kind", DRAWS)
def test_scenarios_are_those_that_evaluation_tries(kind: str) -> None:
    drawn = draw_of(kind)(5, torch.Generator().manual_seed(7))
    for number in range(5):
        one = scenario_of(kind, 5, 7, number)
        assert len(one) == 1
        for name, value in vars(drawn).items():
            assert torch.equal(getattr(one, name)[0], value[number]), name


def test_unknown_scenarios_are_refused() -> None:
    with pytest.raises(SettingsError, match="unknown placement 'moon'"):
        scenario_of("moon", 5, 0, 0)


@given(st.integers(0, 9), st.floats(-3, 3), st.floats(-3, 3))
def test_an_object_stays_on_the_table_wherever_it_is_dragged(n: int, x: float, y: float) -> None:
    before = scenario_of("general", 10, 0, n)
    at = torch.tensor([x, y])
    after = put_object(before, at)
    table = after.table[0]
    room = table[3:5] / 2 - FROM_EDGE

    def local(point: torch.Tensor) -> torch.Tensor:
        return rotate(point - table[:2], -table[2])

    assert (local(after.object[0]).abs() <= room + 1e-5).all()
    if (local(at).abs() < room).all():
        torch.testing.assert_close(after.object[0], at, atol=1e-5, rtol=0)
    assert all(
        torch.equal(getattr(after, name), value)
        for name, value in vars(before).items()
        if name != "object"
    )
