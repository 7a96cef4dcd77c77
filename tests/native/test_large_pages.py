"""Large pages are requested for the whole ones within what is written."""

from pathlib import Path

import pytest
import torch
from support import seeded

from cgtorch.evolution import STRATEGY, compiled
from cgtorch.evolution.operators_in_torch import with_origins
from cgtorch.evolution.population import random_population
from cgtorch.native import available
from cgtorch.tabletop.actions import paper_actions

PAGE, MAPS = 2 << 20, Path("/proc/self/smaps")
SETTING = Path("/sys/kernel/mm/transparent_hugepage/enabled")

pytestmark = pytest.mark.skipif(
    not (available() and SETTING.exists() and MAPS.exists()), reason="there are no large pages here"
)


def asked_for() -> list[range]:
    """The addresses for which large pages were requested."""
    found, place = [], range(0)
    for line in MAPS.read_text().splitlines():
        first = line.split()[0]
        if "-" in first and not first.endswith(":"):
            place = range(*(int(end, 16) for end in first.split("-")))
        elif first == "VmFlags:" and "hg" in line.split():
            found.append(place)
    return found


def test_large_pages_are_requested_for_new_parameters() -> None:
    actions = paper_actions()
    graphs = with_origins(random_population(700, actions, 40, (2, 9), seeded(0)).graphs)
    strategy, old = torch.full((700, len(STRATEGY)), 0.1), torch.zeros(700, 40, 50)
    about = graphs, old, old[:1, 0], actions, strategy, 0.05, 0, 3
    made, _ = compiled.perturb_parameters(*about)
    begin, end = made.data_ptr(), made.data_ptr() + 4 * made.numel()
    whole = range(-(-begin // PAGE) * PAGE, end // PAGE * PAGE)
    assert len(whole) >= PAGE
    inside = [place for place in asked_for() if place.start < end and place.stop > begin]
    assert min(place.start for place in inside) <= whole.start
    assert max(place.stop for place in inside) >= whole.stop
