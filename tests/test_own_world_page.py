"""docs/own-world.md runs from top to bottom and does what it says; so does what it leaves out."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console
from support import seeded
from torch import Tensor

from cgtorch.environment import ScenarioBatch
from cgtorch.graphs import load_skill, save_skill
from cgtorch.improvement.events import Event, ModelsFitted, SkillAccepted, StageStarted
from cgtorch.improvement.grow import grow
from cgtorch.improvement.setup import Progress
from cgtorch.report.progress import ProgressDisplay
from cgtorch.report.tensorboard import TensorBoardWatch
from cgtorch.simulation import Rollouts, rollout

PAGE = Path(__file__).resolve().parents[1] / "docs" / "own-world.md"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """What the page's code has defined at its end."""
    names: dict[str, Any] = {"__name__": "own_world"}
    text = PAGE.read_text()
    for found in re.finditer(r"```python\n(.*?)```", text, re.DOTALL):
        line = text[: found.start(1)].count("\n")  # so that an error names the page's line
        exec(compile("\n" * line + found.group(1), str(PAGE), "exec"), names)  # noqa: S102
    return names


def share(runs: Rollouts) -> float:
    return float(runs.succeeded.float().mean())


def test_the_page_holds_its_promises(page: dict[str, Any]) -> None:
    assert share(page["tried"]) > 0.95
    assert share(page["hasty"]) > 0.95
    actions = {name: float(page[name].transitions.float().mean()) for name in ("tried", "hasty")}
    assert actions["hasty"] < actions["tried"]
    progress = page["progress"]
    assert share(page["tested"]) > 0.95
    # What the stage is about, and as many fresh ones after each of its rounds.
    assert len(progress.solved) + len(progress.missed) in (120, 180, 240)
    assert len(progress.solved) > 100
    world = page["Rail"](progress.solved)
    assert share(rollout(progress.skill.graph, progress.skill.actions, world)) == 1


def test_its_skill_is_kept_like_any_other(page: dict[str, Any], tmp_path: Path) -> None:
    skill = page["progress"].skill
    save_skill(tmp_path / "skill.json", skill)
    again = load_skill(tmp_path / "skill.json", page["actions"])
    runs = rollout(again.graph, again.actions, page["fresh"])
    assert torch.equal(runs.percept, page["tested"].percept)


def test_the_papers_own_way_and_whoever_watches(page: dict[str, Any], tmp_path: Path) -> None:
    """Growing one graph, models that learn, and reports, which know nothing of this domain."""
    told: list[Event] = []
    learned: list[int] = []

    def learn(models: Any, experience: Any, generator: Any) -> Any:
        learned.append(len(experience.percept))
        assert experience.whole(2)
        return models

    console = Console(width=200, record=True, force_terminal=False)
    starts = page["draw"](30, seeded(1))
    setup = replace(page["setup"], learn=learn, attempts=3)
    nothing = starts[:0]
    display = ProgressDisplay(console)
    board = TensorBoardWatch(tmp_path, {}, actions=page["actions"])

    def watch(event: Event) -> None:
        told.append(event)
        display(event)
        board(event)

    watch(StageStarted("rail", ("rail",), 0, 30, setup.attempts))
    models = page["gamma"], page["success"]
    progress = grow(
        setup,
        Progress(None, nothing, nothing, models),
        "rail",
        starts,
        torch.ones(30, dtype=torch.bool),
        lambda generator: nothing,
        seeded(2),
        watch,
    )
    watch(ModelsFitted("rail", models, 0.5))
    board.close()
    assert progress.skill is not None
    accepted = [e for e in told if isinstance(e, SkillAccepted)]
    assert len(accepted) == 1
    assert torch.equal(accepted[0].scenarios.place, starts.place)
    assert len(progress.solved) == int(accepted[0].succeeded.sum()) > 0
    text = console.export_text()
    assert "rail: accepted; test placements" in text
    assert "rail: the models have learned, 0.5 s" in text
    assert learned == [] or min(learned) > 0
    assert list(tmp_path.glob("events*"))


def test_scenarios_are_any_tensors(page: dict[str, Any]) -> None:
    carts: ScenarioBatch = page["draw"](5, seeded(0))
    assert len(carts) == 5
    rows = torch.tensor([3, 0])
    some = carts[rows]
    assert type(some) is page["Carts"]
    joined: Any = some.joined(carts[:1], carts[:0])
    assert len(joined) == 3
    expected: Tensor = torch.cat([carts[rows].place, carts[:1].place])  # type: ignore[attr-defined]
    assert torch.equal(joined.place, expected)
    assert some.with_noise(4) is some
