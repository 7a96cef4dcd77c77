"""Worlds of chance beside what can be computed of them, and the tool that trains in them."""

from collections.abc import Callable
from functools import cache
from math import exp, factorial
from pathlib import Path

import measure_chance as tool
import numpy as np
import pytest
import torch
from chance import inventory, queues
from chance.blackjack import Paid, Signed
from chance.game import GameDomain
from chance.inventory import Store
from chance.pig import Pig, hold_at
from chance.queues import Servers
from click.testing import CliRunner
from measure_chance import Mean, best_rule, by_rule, played, table
from torch import Tensor

COUNT = 20_000


def always(value: float) -> Callable[[Tensor], Tensor]:
    return lambda percept: percept.new_full((len(percept), 1), value)


def agrees(domain: GameDomain, rule: Callable[[Tensor], Tensor], expected: float) -> bool:
    mean = played(domain, by_rule(rule), COUNT)
    return abs(mean.value - expected) < 4 * mean.error


def test_turns_of_pig_are_those_of_its_recursion() -> None:
    # A 1 leads back to the same score, which is a fixed point: from(s) = a + from(s) b.
    found: dict[int, float] = {}
    for score in range(99, -1, -1):

        @cache
        def ways(turn: int, score: int = score) -> tuple[float, float]:
            if score + turn >= 100:
                return 1.0, 0.0
            if turn >= 20:
                return 1.0 + found[score + turn], 0.0
            parts = [ways(turn + die) for die in range(2, 7)]
            return (1 + sum(a for a, _ in parts)) / 6, (1 + sum(b for _, b in parts)) / 6

        a, b = ways(0)
        found[score] = a / (1 - b)
    assert agrees(Pig(), hold_at(20), -found[0])


def test_sticking_at_once_wins_what_the_dealer_leaves() -> None:
    cards = {value: (4 if value == 10 else 1) / 13 for value in range(1, 11)}

    def with_card(total: int, soft: bool, value: int) -> tuple[int, bool]:
        if value == 1 and total + 11 <= 21:
            return total + 11, True
        total += value
        return (total - 10, False) if soft and total > 21 else (total, soft)

    @cache
    def ends(total: int, soft: bool) -> dict[int, float]:
        if total >= 17:
            return {total: 1.0}
        found: dict[int, float] = {}
        for value, chance in cards.items():
            for end, share in ends(*with_card(total, soft, value)).items():
                found[end] = found.get(end, 0.0) + chance * share
        return found

    dealer, won, lost = ends(0, False), 0.0, 0.0
    for first, a in cards.items():
        for second, b in cards.items():
            total, _ = with_card(*with_card(0, False, first), second)
            for end, chance in dealer.items():
                won += a * b * chance * (end > 21 or total > end)
                lost += a * b * chance * (total < end <= 21)
    assert agrees(Paid(), always(-1.0), won)
    assert agrees(Signed(), always(-1.0), won - lost)


def test_hitting_always_loses_everything() -> None:
    assert played(Signed(), by_rule(always(1.0)), 1000) == Mean(-1.0, 0.0)


@pytest.mark.parametrize(("control", "serves"), [(1.0, queues.FAST), (-1.0, queues.SLOW)])
def test_a_single_queue_is_a_chain(control: float, serves: float) -> None:
    chance, waited = np.zeros(queues.SLOTS + 1), 0.0
    chance[0] = 1.0
    numbers = np.arange(queues.SLOTS + 1)
    for _ in range(queues.SLOTS):
        arrived = (1 - queues.ARRIVES) * chance
        arrived[1:] += queues.ARRIVES * chance[:-1]
        served = arrived * np.where(numbers > 0, 1 - serves, 1.0)
        served[:-1] += serves * arrived[1:]
        chance = served
        waited += float(chance @ numbers)
    assert agrees(Servers(), always(control), -waited / queues.SLOTS)


def test_a_store_that_never_orders_sells_what_it_has() -> None:
    demand = [exp(-3.0) * 3.0**n / factorial(n) for n in range(inventory.LARGEST)]
    stock, gain = {10: 1.0}, 0.0
    for _ in range(inventory.DAYS):
        after: dict[int, float] = {}
        for there, chance in stock.items():
            for wanted, share in enumerate([*demand, 1 - sum(demand)]):
                sold = min(there, wanted)
                left, weight = there - sold, chance * share
                gain += weight * (inventory.PRICE * sold - inventory.KEEP * left)
                after[left] = after.get(left, 0.0) + weight
        stock = after
    assert agrees(Store(), always(-1.0), gain)


def test_orders_arrive_after_two_days_and_cost_once() -> None:
    world = Store().world(Store().draw("any", 1, torch.Generator()))
    state, number = torch.tensor([[0.0, 0, 0, 0, 0]]), torch.zeros(1).long()
    for control in (0.5, 0.0):
        state = world.next_state(state, torch.tensor([[control]]), number)
    assert state[0, :3].tolist() == [0.0, 5.0, 0.0]
    assert float(state[0, 3]) == pytest.approx(-inventory.ORDER - 5 * inventory.COST)
    assert float(world.next_state(state, torch.zeros(1, 1), number)[0, 0]) == 5.0


@pytest.mark.hostile
def test_the_best_rule_is_better_than_those_beside_it() -> None:
    name, mean = best_rule(Pig(), 2000)
    others = [played(Pig(), by_rule(rule), 2000).value for rule in Pig.rules().values()]
    assert mean.value == max(others) > min(others)
    assert name in Pig.rules()


def test_table_has_medians_and_counts_those_that_are_no_worse() -> None:
    rows = [
        {"domain": "pig:Pig", "seed": i, "mean": mean, "error": 0.1, "told": mean + off}
        for i, (mean, off) in enumerate([(-12.5, 0.01), (-12.9, -0.3), (-12.7, 0.0)])
    ]
    last = table(rows, {"pig:Pig": ("hold at 20", Mean(-12.6, 0.05))}).splitlines()[-1]
    cells = [cell.strip() for cell in last.split("|")[1:-1]]
    assert cells == ["pig:Pig", "hold at 20", "-12.6000 ± 0.0500", "-12.7000", "2 of 3", "0.3000"]


@pytest.mark.hostile
def test_command_trains_and_tells(tmp_path: Path) -> None:
    about = ["--only", "queues:Servers", "--seeds", "0:1", "--minutes", "0.1", "--count", "500"]
    for _ in range(2):  # the second time nothing is trained
        result = CliRunner().invoke(tool.command, [str(tmp_path), *about])
        assert result.exit_code == 0, result.output
        assert "queues:Servers" in result.output
    assert (tmp_path / "queues-Servers-0.json").is_file()
