"""Operators and selection on what stands in for a GPU, and those of the CPU: the same bits."""

import shutil
from itertools import islice

import pytest
import torch
from emulated_gpu import EmulatedGpu, OnGpu, launchers
from pretended_gpu import GPU, pretended_gpu
from random_models import models_as, random_models
from support import nested_actions, same_individuals, seeded
from torch import Generator, Tensor

from cgtorch.evolution import EvolutionSettings, chance_of_success, compiled, evolve
from cgtorch.evolution.compiled import lexicase as lexicase_in_c
from cgtorch.evolution.fitness import Fitness
from cgtorch.evolution.operators import breed, with_new_origins
from cgtorch.evolution.population import Population, random_population
from cgtorch.evolution.selection import deviation, lexicase, tournament
from cgtorch.graphs import ActionSet, ContinuousNN
from cgtorch.ground.counter_rng import shuffled
from cgtorch.improvement.specialists import shrunk
from cgtorch.native import available
from cgtorch.native import gpu as native_gpu
from cgtorch.native.gpu import Gpu
from cgtorch.simulation import ModelEnvironment, Rollouts
from cgtorch.tabletop.actions import paper_actions

pytestmark = pytest.mark.skipif(
    not available() or shutil.which("c++") is None, reason="there is no C++ compiler"
)

PAPER = paper_actions()
NESTED = nested_actions(2, PAPER)


class Wide(ContinuousNN):
    """A network with initial parameters of its own."""

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        return 3 + torch.rand(n, self.num_parameters, generator=generator)


OWN = ActionSet((*PAPER.names, "Wide"), (*PAPER.actions, Wide(7, 3, 3)))


def device_name(launcher: Gpu) -> str:
    return str(launcher.device)


def population_of(seed: int, actions: ActionSet, size: int = 60) -> Population:
    return random_population(size, actions, 12, (2, 9), seeded(seed))


@pytest.mark.parametrize("launcher", launchers(), ids=device_name)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("mutates", [False, True])
def test_children_are_the_same(mutates: bool, dtype: torch.dtype, launcher: Gpu) -> None:
    population, g = population_of(1, OWN), seeded(2)
    population.graphs.parameters.data = population.graphs.parameters.to(dtype)
    elite, parents = torch.tensor([7, 3]), torch.randint(60, (58,), generator=g)
    about = population, elite, parents, (11, -5), OWN if mutates else None, 12
    wanted, strategy, begins = breed(*about)
    there = launcher.device
    moved = population.to(there), elite.to(there), parents.to(there), *about[3:]
    made, same_strategy = compiled.breed(*moved, launcher)
    if mutates:
        made, found_begins = with_new_origins(made, OWN.standard)
        assert found_begins == begins
    for name, tensor in vars(wanted).items():
        assert torch.equal(getattr(made, name).cpu(), tensor), name
    assert torch.equal(strategy, same_strategy.cpu())
    if mutates:
        old, fresh = population.graphs.parameters, torch.rand(begins[-1], 50, dtype=dtype)
        fresh = fresh[:, : old.shape[2]].contiguous()
        on_cpu = compiled.perturb_parameters(wanted, old, fresh, OWN, strategy, 0.05, 2, 99)
        given = made, old.to(there), fresh.to(there), OWN, same_strategy
        for one, other in zip(
            on_cpu, compiled.perturb_parameters(*given, 0.05, 2, 99, launcher), strict=True
        ):
            assert torch.equal(one, other.cpu())


def test_parents_outside_are_refused() -> None:
    population = population_of(1, PAPER)
    parents = torch.tensor([0, 60])
    with pytest.raises(IndexError, match="not in the population"):
        compiled.breed(population, parents[:0], parents, (1, 2), PAPER, 12, EmulatedGpu())


def scores_of(kind: str, seed: int, size: int, scenarios: int) -> Tensor:
    g = seeded(seed)
    scores = torch.rand(size, scenarios, generator=g)
    if kind == "few":  # many equal rows, and zeros of both signs
        scores = (scores * 3).floor() / 2
        scores[::3] *= -1
    if kind == "equal":
        scores = scores[:1].expand(size, -1).contiguous()
    return scores


@pytest.mark.parametrize("kind", ["any", "few", "equal"])
@pytest.mark.parametrize(("size", "scenarios"), [(2, 1), (70, 9), (1024, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("launcher", launchers(), ids=device_name)
def test_one_group_has_the_same_parents(
    kind: str, size: int, scenarios: int, dtype: torch.dtype, launcher: Gpu
) -> None:
    scores = scores_of(kind, size, size, scenarios).to(dtype)
    wanted = lexicase_in_c(scores, deviation(scores), 40, 17)
    members = torch.arange(size, device=launcher.device)
    found = compiled.lexicase_on_gpu(launcher, scores.to(launcher.device), members, [17], 40)
    assert torch.equal(found.cpu(), wanted)
    assert kind == "equal" or size == 2 or len(wanted.unique()) > 3


@pytest.mark.parametrize("launcher", launchers(), ids=device_name)
@pytest.mark.parametrize("count", [1, 5, 1000])
def test_orders_are_the_same(count: int, launcher: Gpu) -> None:
    found = compiled.shuffled(count, -3, launcher.device, launcher)
    assert torch.equal(found.cpu(), shuffled(count, -3))


@pytest.fixture
def everything_on_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors that say they are on a GPU are given to what stands in for it."""
    monkeypatch.setattr(native_gpu, "gpu_of", lambda device: OnGpu())


@pytest.mark.usefixtures("everything_on_gpu")
def test_groups_have_the_same_parents() -> None:
    scores, order = scores_of("few", 3, 2500, 4), torch.arange(2500)
    wanted = lexicase(order, scores, 31, seeded(5))
    with pretended_gpu():
        found = lexicase(order.to(GPU), scores.to(GPU), 31, seeded(5))
        assert found.is_cuda
        assert torch.equal(found.cpu(), wanted)


@pytest.mark.usefixtures("everything_on_gpu")
@pytest.mark.parametrize(
    ("actions", "selection"),
    [pytest.param(OWN, tournament(), marks=pytest.mark.hostile), (NESTED, lexicase)],
)
def test_whole_evolutions_are_the_same(actions: ActionSet, selection: object) -> None:
    environment = models_as(random_models(3, 7), torch.float32)
    settings = EvolutionSettings(population=40, selection=selection, islands=2, migration=2)
    keep = torch.arange(7) < 1

    def evolved(where: ModelEnvironment, kept: Tensor) -> list[Population]:
        found = []
        for generation in islice(evolve(where, actions, settings, seeded(0), keep=kept), 5):
            found += [i.population.to("cpu") for i in generation.islands]
            found.append(generation.champion)
            # Engines in torch and for own actions find out about endless loops at other times.
            executed = 0 if actions is OWN else generation.executed
            counts.append((generation.transitions, executed, generation.best))
        return found

    counts: list[tuple[int, int, float]] = []
    wanted = evolved(environment, keep)
    with pretended_gpu():
        there = evolved(models_as(environment, torch.float32, GPU), keep.to(GPU))
    assert counts[:5] == counts[5:]
    for one, other in zip(there, wanted, strict=True):
        assert same_individuals(one, other)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
@pytest.mark.parametrize("actions", [OWN, NESTED])
def test_whole_evolutions_on_this_machines_gpu_are_those_of_the_cpu(actions: ActionSet) -> None:
    environment = models_as(random_models(3, 7), torch.float32)
    settings, keep = EvolutionSettings(population=3000), torch.arange(7) < 1
    there = models_as(environment, torch.float32, GPU)
    for one, other in islice(
        zip(
            evolve(there, actions, settings, seeded(0), keep=keep.to(GPU)),
            evolve(environment, actions, settings, seeded(0), keep=keep),
            strict=True,
        ),
        6,
    ):
        assert one.population.strategy.is_cuda
        assert same_individuals(one.population.to("cpu"), other.population)
        assert one.best == other.best


def hurried(runs: Rollouts, chance: Tensor) -> Tensor:
    return chance / (1 + runs.transitions / 100)


def shrunk_champion(
    environment: ModelEnvironment, actions: ActionSet, fitness: Fitness, keep: Tensor
) -> tuple[list[Tensor], list[float]]:
    """A champion, shrunk, and the best fitness of each of two generations."""
    settings = EvolutionSettings(population=30, fitness=fitness)
    found = evolve(environment, actions, settings, seeded(0), keep=keep)
    generations = list(islice(found, 2))
    last = generations[-1].champion
    small = shrunk(last, actions, environment, 20, 1e-3, fitness, keep.device)
    assert small.graphs.start.is_cpu  # evolution itself is on the CPU
    return [*vars(small.graphs).values()], [g.best for g in generations]


@pytest.mark.parametrize(
    ("actions", "fitness", "kept"),
    [(PAPER, hurried, 1), pytest.param(NESTED, chance_of_success, 0, marks=pytest.mark.hostile)],
)
def test_evolutions_by_rollouts_in_torch_are_the_same(
    actions: ActionSet, fitness: Fitness, kept: int
) -> None:
    environment = models_as(random_models(3, 3), torch.float32)
    keep = torch.arange(3) < kept
    with pretended_gpu():
        elsewhere = models_as(environment, torch.float32, GPU)
        found, best = shrunk_champion(elsewhere, actions, fitness, keep.to(GPU))
    wanted, wanted_best = shrunk_champion(environment, actions, fitness, keep)
    assert best == pytest.approx(wanted_best, rel=1e-5)  # on the CPU Γ and C are compiled
    assert max(best) > 0 or kept
    assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))
