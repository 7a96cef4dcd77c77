"""docs/own-domain.md runs from top to bottom and does what it says."""

import re
from pathlib import Path
from typing import Any

import pytest
import torch
from support import seeded

from cgtorch import Domain
from cgtorch.domains.check import check_domain
from cgtorch.domains.exploration import Exploration
from cgtorch.domains.knowledge import Knowledge
from cgtorch.evolution import episode_return, evolve
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Dataset, Environment, ScenarioBatch
from cgtorch.simulation import Rollouts, rollout

PAGE = Path(__file__).resolve().parents[1] / "docs" / "own-domain.md"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """What the page's code has defined at its end."""
    names: dict[str, Any] = {"__name__": "own_domain"}
    text = PAGE.read_text()
    for found in re.finditer(r"```python\n(.*?)```", text, re.DOTALL):
        line = text[: found.start(1)].count("\n")  # so that an error names the page's line
        exec(compile("\n" * line + found.group(1), str(PAGE), "exec"), names)  # noqa: S102
    return names


def explored(domain: Domain[Any], most: int) -> Dataset:
    """The data of an exploration of a domain with at most so many motions."""
    generator = seeded(0)

    def worlds(kind: str, count: int) -> Environment:
        return domain.world(domain.draw(kind, count, generator))

    def fit(data: Dataset) -> Knowledge:
        return domain.models(domain).fit(data, 0)

    about = domain.kinds[0], worlds, fit, most, 2, generator, Purse()
    return domain.models(domain).explore(Exploration(*about))


def share(runs: Rollouts) -> float:
    return float(runs.succeeded.float().mean())


def test_the_page_holds_its_promises(page: dict[str, Any]) -> None:
    assert share(page["tried"]) > 0.95
    assert share(page["hasty"]) > 0.95
    actions = {name: float(page[name].transitions.float().mean()) for name in ("tried", "hasty")}
    assert actions["hasty"] < actions["tried"]


@pytest.mark.parametrize("name", ["Cart", "Windy", "Balanced", "Guided", "Far", "GustyCart"])
def test_its_domains_keep_the_interface(page: dict[str, Any], name: str) -> None:
    domain = page[name]()
    check_domain(domain, domain.kinds[0])


def test_experience_begins_nearer_to_success(page: dict[str, Any]) -> None:
    far = page["Far"]()
    assert far.kinds[0] == "far"
    assert far.draw("far", 50, seeded(0)).place.abs().min() >= 2
    data, same = explored(far, 40), explored(page["Cart"](), 40)
    assert torch.equal(data.tested, same.tested)


def test_most_that_is_tried_leads_towards_success(page: dict[str, Any]) -> None:
    data = explored(page["Guided"](), 40)
    towards = data.control[:, 0] * data.percept[:, 0] < 0
    assert 0.6 < float(towards.float().mean()) < 1


def test_a_world_that_does_not_repeat_itself_is_no_error(page: dict[str, Any]) -> None:
    assert check_domain(page["Cart"](), "any")
    assert not check_domain(page["Unrepeated"](), "any")


def test_noise_belongs_to_scenarios(page: dict[str, Any]) -> None:
    domain = page["GustyCart"]()
    carts = domain.draw("any", 200, seeded(0))

    def moved(copy: int) -> torch.Tensor:
        world = domain.world(carts.with_noise(copy))
        state = world.first_state(torch.arange(200))
        for _ in range(2):
            state = world.next_state(state, torch.zeros(200, 1), torch.arange(200))
        return state[:, 0] - carts.place

    assert torch.equal(moved(0), moved(0))
    assert moved(0).std() == pytest.approx(0.05 * 2**0.5, rel=0.15)
    correlation = torch.corrcoef(torch.stack([moved(0), moved(1)]))[0, 1]
    assert correlation.abs() < 0.2


def test_settings_are_heeded(page: dict[str, Any]) -> None:
    calm = page["Windy"](page["WindySettings"](gusts=0.0))
    assert not calm.draw("any", 20, seeded(0)).wind.any()


def test_rewards_are_evolved_for(page: dict[str, Any]) -> None:
    domain, generator = page["Balanced"](), seeded(1)
    world = domain.world(domain.draw("any", 8, generator))
    settings = EvolutionSettings(population=60, fitness=episode_return)
    for generation in evolve(world, domain.actions(), settings, generator):
        if generation.number == 12:
            break
    runs = rollout(generation.champion.graphs, domain.actions(), world)
    assert runs.returns is not None
    assert generation.best == pytest.approx(float(runs.returns.mean()), abs=1e-5)
    assert generation.best > 3


def test_scenarios_are_any_tensors(page: dict[str, Any]) -> None:
    carts: ScenarioBatch = page["Cart"]().draw("any", 5, seeded(0))
    assert len(carts) == 5
    rows = torch.tensor([3, 0])
    some: Any = carts[rows]
    assert type(some) is page["Carts"]
    joined: Any = some.joined(carts[:1], carts[:0])
    assert len(joined) == 3
    assert torch.equal(joined.place, torch.cat([some.place, vars(carts)["place"][:1]]))
    assert some.with_noise(4) is some
