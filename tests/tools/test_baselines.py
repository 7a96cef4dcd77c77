"""The ways of work that the benchmark compares the engine with end as the engine does."""

from functools import cache
from pathlib import Path
from random import Random

import click
import pytest
import torch
from benchmarks import generation, on_gpu, paper_way, strong_cpu
from benchmarks.array_models import ArrayModels
from benchmarks.gating import gating_gradient
from benchmarks.generation import (
    INSIDE,
    MODELS,
    PARTS,
    generation_split,
    one_evolution,
    rollout_parts,
)
from benchmarks.growth import equal, padding
from benchmarks.measure import DisagreementError, Effort
from benchmarks.networkx_operators import individuals, kinds_of
from benchmarks.operators import apart, as_graphs, children, networkx_children, statistics_of
from benchmarks.plain_models import PlainModels, plain_models
from benchmarks.rollouts import alike, taken
from benchmarks.tensor_way import tensor_rollout
from benchmarks.touching import touching
from benchmarks.workload import Workload, first_population, workload_of
from support import random_graphs, seeded
from torch import Tensor

from cgtorch.graphs import NO_NODE, Graphs, widened
from cgtorch.runs.storage import load_knowledge
from cgtorch.runs.stored_run import read_run
from cgtorch.simulation import Rollouts, rollout
from cgtorch.tabletop.domain import Tabletop

REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference"
LIMIT = 12


@cache
def work() -> Workload:
    run = read_run(REFERENCE)
    assert isinstance(run.domain, Tabletop)
    knowledge = load_knowledge(REFERENCE / run.stages[-1], run.models.unfitted())
    return workload_of(knowledge, run.domain, 6, seeded(0))


@cache
def models() -> PlainModels:
    return plain_models(work())


def graphs_to_run() -> Graphs:
    """Random graphs, and chains that speak, move and grasp, so that much happens."""
    graphs = random_graphs(0, 60, work().actions, capacity=8, nodes=(4, 8))
    names = work().actions.names
    chain = [names.index(n) for n in ("ContinuousNN", "MoveBase", "BranchingNN", "Detect", "Grasp")]
    action = torch.full((60, 8), NO_NODE)
    action[:, :5] = torch.tensor(chain)
    edges = torch.full((60, 8, 2), NO_NODE)
    edges[:, :5] = torch.tensor([[1, NO_NODE], [2, 2], [3, 4], [4, NO_NODE], [NO_NODE, 0]])
    parameters = torch.zeros(60, 8, graphs.parameters.shape[2])
    for node in (0, 2):
        count = int(work().actions.num_parameters[chain[node]])
        parameters[:, node, :count] = torch.randn(60, count, generator=seeded(node + 2))
    both = Graphs(action, edges, parameters, torch.zeros(60, dtype=torch.long))
    return Graphs(
        *(torch.cat(p) for p in zip(vars(graphs).values(), vars(both).values(), strict=True))
    )


@cache
def runs() -> Rollouts:
    return rollout(graphs_to_run(), work().actions, work().environment, max_transitions=LIMIT)


def test_the_graphs_do_everything() -> None:
    assert set(graphs_to_run().action.unique().tolist()) == {NO_NODE, *range(5)}
    assert (runs().state[..., 0] > 0).float().mean() > 0.3  # moved
    assert runs().succeeded.any()
    assert runs().timed_out.any()


def test_the_papers_way_ends_as_the_engine_does() -> None:
    simulation = paper_way.Simulation(models())
    machines = paper_way.state_machines(graphs_to_run(), work().actions)
    gap, differ = alike(runs(), *paper_way.run_all(simulation, machines, 6, LIMIT))
    assert gap < 1e-2
    assert differ < 1e-3


@pytest.mark.hostile
def test_the_strong_cpu_way_ends_as_the_engine_does_in_any_process() -> None:
    arrays = strong_cpu.array_graphs(graphs_to_run(), work().actions)
    alone = strong_cpu.run_share(ArrayModels(models()), LIMIT, arrays)
    alike(runs(), *alone)
    with strong_cpu.processes(models(), 1) as pool:
        shared = strong_cpu.run_all(pool, 1, arrays[:10], LIMIT)
    assert all((a[:10] == b).all() for a, b in zip(alone, shared, strict=True))


def test_the_tensor_way_gives_the_same_numbers() -> None:
    others = tensor_rollout(graphs_to_run(), work().actions, work().environment, LIMIT)
    for name in ("succeeded", "timed_out", "transitions"):
        assert torch.equal(getattr(others, name), getattr(runs(), name)), name
    # Networks in torch and compiled round otherwise, and each motion makes more of it.
    torch.testing.assert_close(others.percept, runs().percept, atol=1e-4, rtol=0)


def test_lanes_that_end_otherwise_are_noticed() -> None:
    part = taken(runs(), torch.arange(5))
    for wrong in (
        (~part.succeeded, part.percept, part.transitions),
        (part.succeeded, part.percept + 0.1, part.transitions),
        (part.succeeded, part.percept * float("nan"), part.transitions),
        (part.succeeded, part.percept, part.transitions + 1),
    ):
        with pytest.raises(DisagreementError):
            alike(part, *wrong)


def both_children(count: int) -> tuple[Tensor, Tensor]:
    population, actions = first_population(count, work().actions), work().actions
    parents = individuals(population, actions)
    others = networkx_children(parents, kinds_of(actions), Random(0))
    ours = children(population, actions, seeded(0)).graphs
    return statistics_of(ours, actions), statistics_of(as_graphs(others, actions), actions)


def test_operators_on_networkx_graphs_make_the_same_children_on_average() -> None:
    ours, others = both_children(800)
    assert apart(ours, others) < 5
    for column in range(ours.shape[1]):
        shifted = others.clone()
        shifted[:, column] += ours[:, column].std()
        with pytest.raises(DisagreementError):
            apart(ours, shifted)


def test_a_generation_is_split_into_all_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generation, "MORE", 500)  # few individuals take hardly any time
    looked = one_evolution(work(), 30, (0, 3))
    assert list(looked) == [0, 3]
    assert not torch.equal(*(each.population.strategy for each in looked.values()))
    for each in looked.values():
        assert set(each.seconds) == {"rollouts", "selection", "operators", "logging"}
        assert all(seconds > 0 for seconds in each.seconds.values())
        seconds = generation_split(work(), each)
        assert set(seconds) == set(PARTS)
        assert all(seconds[name] > 0 for name in MODELS)
        assert sum(seconds.values()) == pytest.approx(sum(each.seconds.values()))
    parts = rollout_parts(work(), looked[3].population)
    assert len(parts) == len(INSIDE)
    assert sum(parts) > 0


@pytest.mark.hostile
def test_lines_of_postures_and_gating_networks() -> None:
    postures, gating = (line(Effort(repeats=5, size=0.05)) for line in (touching, gating_gradient))
    assert [part.label for part in (*postures.parts, *gating.parts)] == [
        "pr2, 200 postures", "fetch, 200 postures",
        "S1: 760 scenarios, 2 members", "S3: 1160 scenarios, 4 members",
    ]  # fmt: skip
    assert all(part.difference == 0 for part in postures.parts)
    assert all(part.ratio > 0 for part in (*postures.parts, *gating.parts))


@pytest.mark.hostile
def test_more_room_is_measured_where_it_changes_nothing() -> None:
    rollouts, generation = padding(Effort(1, 0.05)).parts
    assert rollouts.ratio > 0
    assert generation.ratio > 0
    graphs = graphs_to_run()
    wider = widened(graphs, graphs.capacity + 1)
    assert equal(wider, widened(graphs, graphs.capacity + 1))
    assert not equal(wider, graphs)


@pytest.fixture
def cpu_as_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines of --device cuda compare the CPU with itself, so they run where there is no GPU."""
    small = first_population(40, work().actions)
    monkeypatch.setattr(on_gpu, "GPU", torch.device("cpu"))
    monkeypatch.setattr(on_gpu, "launcher_of", lambda device: device)
    monkeypatch.setattr(on_gpu, "workload", work)
    monkeypatch.setattr(on_gpu, "later_population", lambda size: small)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "pretended")


@pytest.mark.usefixtures("cpu_as_gpu")
def test_gpu_lines_run_and_compare() -> None:
    population, cpu = first_population(40, work().actions), torch.device("cpu")
    once = on_gpu._generation(work(), work().environment, population, cpu)
    one, two = (once().population for _ in range(2))
    on_gpu._check_same("strategies", two.strategy, one.strategy)
    with pytest.raises(DisagreementError, match="strategies"):
        on_gpu._check_same("strategies", one.strategy, population.strategy)
    rollouts = on_gpu.gpu_rollouts(Effort(repeats=1, size=1.0))
    generation = on_gpu.gpu_generation(10_000, Effort(repeats=1, size=1.0))
    assert rollouts.parts[0].label == "40 x 6"
    assert generation.parts[0].label == "population 40"
    assert "pretended, the same bits" in generation.compared
    assert generation.target == on_gpu.GENERATIONS[10_000]
    assert all(line.ratio > 0 for line in (rollouts, generation))


def test_gpu_lines_ask_for_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(click.ClickException, match="there is no GPU"):
        on_gpu.gpu_generation(10_000, Effort(repeats=1, size=1.0))
