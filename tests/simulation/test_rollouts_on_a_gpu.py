"""Rollouts where tensors say that they are on a GPU: nothing is mixed, and nobody waits."""

import pytest
import torch
from pretended_gpu import GPU, pretended_gpu
from random_models import models_as, random_models
from support import (
    as_double,
    as_double_actions,
    custom_actions,
    nested_actions,
    random_graphs,
)
from told_by_runs import tensors_of

from cgtorch.graphs import ActionSet
from cgtorch.simulation import rollout
from cgtorch.simulation.program import compile_graphs
from cgtorch.simulation.torch_engine import rollout_in_torch
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.edge_networks import edge_actions

AT_ONCE = {
    "program.py: check_numbers", "program.py: compile_graphs", "program.py: _table",
    "program.py: skill_tables", "graphs.py: <genexpr>",
}  # fmt: skip
"""Where the host waits once for all that is rolled out, or copies tables of graphs."""
EVERY_STEP = "torch_engine.py: _grouped"


def sets_for(size: int) -> dict[str, ActionSet]:
    paper = paper_actions(size)
    sets = {
        "paper": paper,
        "edge": edge_actions(size),
        "nested": nested_actions(3, paper),
        "custom": custom_actions(),
    }
    return {name: as_double_actions(actions) for name, actions in sets.items()}


@pytest.mark.parametrize(
    ("which", "scene"),
    [
        ("paper", ("box", 0)),
        ("paper", ("yaw", 2)),
        ("edge", ("yaw", 2)),
        pytest.param("nested", ("box", 0), marks=pytest.mark.hostile),
        ("custom", ("yaw", 2)),
    ],
)
def test_rollouts_are_the_same_and_the_host_waits_once_a_step(
    which: str, scene: tuple[str, int]
) -> None:
    environment = random_models(1, 6, *scene)
    actions = sets_for(environment.percept_size)[which]
    graphs, scenarios = as_double(random_graphs(1, 20, actions)), torch.arange(6)
    program, steps = compile_graphs(graphs, actions), 0

    def count(*_: object) -> None:
        nonlocal steps
        steps += 1

    wanted = rollout_in_torch(program, environment, scenarios, 20, 400)
    rollout_in_torch(program, environment, scenarios, 20, 400, count)  # every transition is made
    with pretended_gpu() as gpu:
        elsewhere = models_as(environment, device=GPU)
        moved, some = graphs.to(GPU), scenarios.to(GPU)
        gpu.waits.clear()
        found = rollout(moved, actions, elsewhere, scenarios=some)
        waits = dict(gpu.waits)
        assert all(x.device == GPU for x in tensors_of(found).values())
        for name, value in tensors_of(found).items():  # on the CPU Γ and C are compiled
            torch.testing.assert_close(value.cpu(), getattr(wanted, name), atol=1e-9, rtol=0)
    assert 5 < waits.pop(EVERY_STEP) <= steps + 1
    assert set(waits) <= AT_ONCE


def test_tensors_of_two_devices_are_refused_and_waiting_is_counted() -> None:
    """So that the test above can fail."""
    with pretended_gpu() as gpu:
        there, here = torch.arange(3, device="cuda"), torch.arange(3)
        assert there.device == GPU
        assert (there + 1).device == GPU
        assert not (there * 2).is_cpu
        with pytest.raises(AssertionError, match="add of tensors on two devices"):
            there + here
        with pytest.raises(AssertionError, match="__getitem__ of tensors on two devices"):
            here[there]
        assert not gpu.waits
        for count, wait in enumerate(
            (
                lambda: there.nonzero(),
                lambda: bool(there.any()),
                lambda: there[there > 1],
                lambda: there.to("cpu"),
                lambda: here.to("cuda"),
                lambda: there[here],
                lambda: there.repeat_interleave(there),
            ),
            1,
        ):
            wait()
            assert gpu.waits.total() == count
        assert there.double().to(there).device == GPU
        assert gpu.waits.total() == 7
        copied = here.to("cuda")
        copied += 1
        assert here.tolist() == [0, 1, 2]
