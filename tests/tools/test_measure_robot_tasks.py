"""What is told of robot benchmarks: the table, and forward transfer."""

from typing import Any

import pytest
from measure_robot_tasks import PUBLISHED, forward_transfer, table


def result(domain: str, seed: int, steps: dict[str, int], solved: dict[str, int]) -> dict[str, Any]:
    return {
        "domain": domain, "seed": seed, "seconds": 1.0,
        "official": {task: [good, 50, 100.0] for task, good in solved.items()},
        "steps": {stage: [n, n // 2] for stage, n in steps.items()},
    }  # fmt: skip


def alone(task: str, seed: int, steps: int, solved: int) -> dict[str, Any]:
    return result(f"metaworld:{task}", seed, {f"01-{task}": steps}, {task: solved})


SET = result(
    "metaworld:CW10", 3, {"01-hammer-v3": 7, "02-push-v3": 10_000, "03-faucet-v3": 30_000},
    {"hammer-v3": 50, "push-v3": 50, "faucet-v3": 40},
)  # fmt: skip


def test_transfer_is_the_share_of_steps_that_is_saved_where_all_goals_are_solved() -> None:
    pair = {
        ("push-v3", 3): alone("push-v3", 3, 40_000, 50),
        ("faucet-v3", 3): alone("faucet-v3", 3, 30_000, 50),
    }
    saved = 1 - 10_000 / 40_000
    lost = (0.8 * (1 - 0.03) - (1 - 0.03)) / 0.03  # of goals, at equal steps
    assert forward_transfer(SET, pair) == pytest.approx((saved + lost) / 2)


def test_transfer_is_unknown_without_each_task_alone_at_the_same_seed() -> None:
    other = {("push-v3", 3): alone("push-v3", 3, 1, 50), ("faucet-v3", 4): SET}
    assert forward_transfer(SET, other) is None


def test_steps_beyond_the_published_budget_leave_no_area() -> None:
    pair = {
        (task, 3): alone(task, 3, 2 * PUBLISHED, 50) for task in ("push-v3", "faucet-v3")
    }  # fmt: skip
    assert forward_transfer(SET, pair) == pytest.approx((0.99 + 0.8 * 0.97) / 2)


def test_table_tells_transfer_beside_sums_of_all_stages() -> None:
    tasks = alone("push-v3", 3, 20_000, 50), alone("faucet-v3", 3, 60_000, 40)
    lines = table([SET, *tasks]).splitlines()
    expected = (0.5 + (0.8 * 0.97 - 0.8 * 0.94) / (1 - 0.8 * 0.94)) / 2
    cells = [cell.strip() for cell in lines[2].split("|")[1:-1]]
    assert cells == [
        "metaworld:CW10", "3", "93.3%", "80%", "40,007", "20,003", "1", f"{expected:.2f}",
    ]  # fmt: skip
    assert lines[3].endswith("| – |")
