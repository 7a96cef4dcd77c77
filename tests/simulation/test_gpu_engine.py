"""The engine for GPUs, on what stands in for one, and that of the CPU: the same in every bit."""

import copy
import shutil
from typing import Any

import pytest
import torch
from emulated_gpu import EmulatedGpu, launchers
from random_kernel_models import DOMAINS, actions_for, random_kernel_models
from random_models import models_as, random_models
from support import (
    FOOTPRINT,
    as_double,
    as_double_actions,
    custom_actions,
    nested_actions,
    random_graphs,
    recurrent_actions,
)
from told_by_runs import tensors_of

from cgtorch.graphs import ActionSet, Graphs, RecurrentNN
from cgtorch.ground.errors import GraphError
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts
from cgtorch.simulation.gpu_engine import GpuEngine
from cgtorch.simulation.rollout import engine_of
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.edge_networks import edge_actions, edge_way_actions
from cgtorch.tabletop.world import ClearMotion

pytestmark = pytest.mark.skipif(
    not available() or shutil.which("c++") is None, reason="there is no C++ compiler"
)

SCENES = [("box", 0), ("box", 1), ("yaw", 0), ("yaw", 3)]
PLACES = [
    *((scene, torch.float32) for scene in SCENES),
    *((scene, torch.float64) for scene in SCENES[1::2]),
]
SETS = ["paper", "edge", "both", "nested", "way"]


def actions_of(which: str, size: int) -> ActionSet:
    paper, edge = paper_actions(size), edge_actions(size)
    both = ActionSet(
        (*paper.names, "EdgeNN", "EdgeBranchingNN"), (*paper.actions, *edge.actions[3:])
    )
    way, nested = edge_way_actions(size, FOOTPRINT), nested_actions(3, both)
    return {"paper": paper, "edge": edge, "both": both, "nested": nested, "way": way}[which]


def moved(environment: ModelEnvironment, device: torch.device) -> ModelEnvironment:
    """The same models there."""
    if device.type == "cpu":
        return environment
    gamma, classifier = environment.gamma.__self__, environment.classifier  # type: ignore[attr-defined]
    possible, errors = environment.possible, environment.errors
    if isinstance(possible, ClearMotion):
        possible = ClearMotion(possible.footprint.to(device))
    return ModelEnvironment(
        environment.percepts.to(device), copy.deepcopy(gamma).to(device).predict_with_novelty,
        copy.deepcopy(classifier).to(device), possible, environment.control_size,
        None if errors is None else errors.to(device), environment.most_novel,
        compiled=environment.compiled, chance=environment.first_state[:, 2].to(device),
    )  # fmt: skip


def assert_same(
    actions: ActionSet, environment: ModelEnvironment, graphs: Graphs, kept: int = 0
) -> Rollouts:
    """Rollouts and evaluations are the same in every bit; what the rollouts were."""
    cpu, scenarios = (
        engine_of(actions, environment),
        torch.arange(environment.num_scenarios).flip(0),
    )
    assert cpu is not None
    wanted = cpu.rollouts(graphs, scenarios, 20, 400)
    assert wanted is not None
    for launcher in launchers():
        there = launcher.device
        elsewhere = moved(environment, there)
        gpu = engine_of(actions, elsewhere, launcher)
        assert isinstance(gpu, GpuEngine)
        found = gpu.rollouts(graphs.to(there), scenarios.to(there), 20, 400)
        assert found is not None
        assert wanted.executed == found.executed
        for name, tensor in tensors_of(wanted).items():
            same = tensors_of(found)[name].cpu()
            torch.testing.assert_close(same, tensor, rtol=0, atol=0, equal_nan=True)
        for cost in (0.0, 0.07):
            given = scenarios, kept, 20, 400, cost
            evaluated = cpu.evaluation(graphs, *given)
            also = gpu.evaluation(graphs.to(there), scenarios.to(there), *given[1:])
            assert evaluated is not None
            assert also is not None
            for one, other in zip(evaluated, also, strict=True):
                if isinstance(one, torch.Tensor):
                    torch.testing.assert_close(other.cpu(), one, rtol=0, atol=0)
                else:
                    assert one == other
    return wanted


def pairs() -> list[Any]:
    """Each place with each set of actions, most of them hostile, as each is a kernel to compile.

    What is left has each place twice, and each set.
    """
    found = []
    for place, (scene, dtype) in enumerate(PLACES):
        for number, which in enumerate(SETS):
            often = which == "nested" or number == place % len(SETS)
            marks = () if often else pytest.mark.hostile
            found.append(pytest.param(scene, dtype, which, marks=marks))
    return found


@pytest.mark.parametrize(("scene", "dtype", "which"), pairs())
def test_the_tabletop_is_the_same_in_all_scenes(
    scene: tuple[str, int], dtype: torch.dtype, which: str
) -> None:
    environment = models_as(random_models(5, 7, *scene), dtype)
    actions = actions_of(which, environment.percept_size)
    graphs = random_graphs(2, 14, actions)
    if dtype == torch.float64:
        graphs, actions = as_double(graphs), as_double_actions(actions)
    assert_same(actions, environment, graphs, kept=3)


@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize("nested", [False, True])
def test_any_domain_is_the_same(domain: str, nested: bool) -> None:
    environment = random_kernel_models(3, 7, *DOMAINS[domain])
    actions = actions_for(environment, 4, nested)
    assert_same(actions, environment, as_double(random_graphs(4, 14, actions)), kept=2)


def test_what_is_not_finite_counts_for_nothing_there_too() -> None:
    environment = models_as(random_models(3, 9), torch.float32)
    actions = paper_actions()
    graphs = random_graphs(3, 12, actions)
    graphs.parameters[2, 0, 0] = torch.nan
    graphs.parameters[3, 0, 1] = torch.inf
    environment.percepts[1, 5] = torch.nan
    environment.first_state[1, 2] = torch.nan
    gpu = engine_of(actions, environment, EmulatedGpu())
    assert gpu is not None
    found = gpu.evaluation(graphs, torch.arange(9), 4, 20, 400)
    assert found is not None
    assert found[-1] >= 2
    assert_same(actions, environment, graphs, kept=4)


def test_wrong_graphs_are_told() -> None:
    environment, actions = models_as(random_models(0, 4), torch.float32), paper_actions()
    graphs = random_graphs(0, 6, actions)
    graphs.edges[2, 0, 0] = 1000
    gpu = engine_of(actions, environment, EmulatedGpu())
    assert gpu is not None
    with pytest.raises(GraphError, match="1000"):
        gpu.rollouts(graphs, torch.arange(4), 20, 400)


@pytest.mark.parametrize("name", ["Counter", "RecurrentNN"])
def test_graphs_with_own_actions_or_memory_are_left_to_others(name: str) -> None:
    environment = models_as(random_models(0, 4), torch.float32)
    actions = custom_actions() if name == "Counter" else recurrent_actions()
    graphs = random_graphs(0, 30, paper_actions())
    gpu = engine_of(actions, environment, EmulatedGpu())
    assert isinstance(gpu, GpuEngine)
    assert gpu.rollouts(graphs, torch.arange(4), 20, 400) is not None
    graphs.action[3, 0] = actions.index(name)
    assert gpu.rollouts(graphs, torch.arange(4), 20, 400) is None


def test_kernels_have_the_sizes_of_the_networks_that_they_run() -> None:
    environment = models_as(random_models(0, 4), torch.float32)
    paper = paper_actions()
    both = paper.extended(["RecurrentNN"], [RecurrentNN(7, 20)])
    engines = [engine_of(actions, environment, EmulatedGpu()) for actions in (paper, both)]
    assert all(isinstance(engine, GpuEngine) for engine in engines)
    sizes = [engine.module.defines() for engine in engines if isinstance(engine, GpuEngine)]
    for name in ("INPUTS", "HIDDEN", "MOST_HIDDEN"):
        assert sizes[0][name] == sizes[1][name]
    graphs = random_graphs(0, 30, paper)
    one, other = (e.rollouts(graphs, torch.arange(4), 20, 400) for e in engines if e)
    assert one is not None
    assert other is not None
    for name, tensor in tensors_of(one).items():
        assert torch.equal(tensors_of(other)[name], tensor), name


def test_more_lanes_than_threads_at_once() -> None:
    """Threads take new lanes while others of their warp are busy."""
    environment, actions = models_as(random_models(1, 16), torch.float32), paper_actions()
    met = assert_same(actions, environment, random_graphs(6, 150, actions), kept=5)
    moved, lost = met.state[..., 0], met.state[..., 1]
    ends = met.succeeded.sum(), met.timed_out.sum(), (moved > 1).sum(), (lost > 0).sum()
    assert min(map(int, ends)) >= 20, ends
