"""What `cgtorch-train` says before a run and after it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rewarded_cart import RewardedCart
from trained import SMALL, Trained, copied

from cgtorch import DomainSettings
from cgtorch.commands import training
from cgtorch.commands.training import _after, _before, _end, usual_processes
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import Purse
from cgtorch.runs.chosen import resuming
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import AUTO, StoredRun, planned_run, read_run
from cgtorch.training.session import TrainingRequest, Work

HERE = Path("runs/one")
CART = RunSettings(domain="mine:Cart")
NOTHING: Any = None
SOME_TIME = (
    "  On two quiet cores, S0 to S2 take some 10 seconds, S0 to S3 some 15, and about ten times as "
    "long in physics (--world mujoco). Progress appears here, and in TensorBoard:"
)
ANY_TIME = "  The time depends on the domain. Progress appears here, and in TensorBoard:"
TEN_MINUTES = (
    "  It ends after 10 minutes (--minutes) at the latest. Progress appears here, and in "
    "TensorBoard:"
)
UNTIL_MET = "evolve skills until the target of 0.99 is met"
MODELS = [
    "  2. Evolve skills inside Γ and C, and try the best of them in the world.",
    "  3. Accept a skill if it forgets nothing and solves something new.",
]
IMAGINED = [
    "  1. Play a few short episodes of random controls, and fit Γ and rewards to them.",
    "  2. Evolve skills in imagined episodes, and play the best of them in the world.",
]
REWARDED = [
    "  1. Evolve skills in the world itself, on fresh episodes in each generation.",
    "  2. Keep the best until another skill beats it on further fresh episodes.",
]
WORLD = [
    "  1. Evolve skills in the world itself; no models are learned.",
    "  2. Accept a skill if it forgets nothing and solves something new.",
]


def planned(settings: RunSettings) -> StoredRun:
    domain = RewardedCart(DomainSettings()) if settings.domain == CART.domain else None
    return planned_run(HERE, settings, domain=domain)


def work(run: StoredRun, stage: str = AUTO, limits: Mapping[str, float] | None = None) -> Work:
    return Work(run, stage, Goal(), NOTHING, TrainingRequest(), True, Purse(limits or {}))


@pytest.mark.parametrize(
    ("settings", "stage", "until", "about", "steps", "takes"),
    [
        (
            SMALL, "S1", "evolve one skill for each of S0, S1", "domain tabletop, seed 6",
            ["  1. Collect data, and fit the transition model Γ and the success classifier C.",
             *MODELS], SOME_TIME,
        ),
        (
            replace(SMALL, data=("log.csv",)), AUTO, UNTIL_MET,
            "domain tabletop, seed 6",
            ["  1. Read the data that you give, collect more, and fit the transition model Γ and "
             "the success classifier C.", *MODELS], TEN_MINUTES,
        ),
        (
            replace(SMALL, data=("log.csv",), transitions=0), "S0",
            "evolve one skill for each of S0", "domain tabletop, seed 6",
            ["  1. Read the data that you give, and fit the transition model Γ and the success "
             "classifier C.", *MODELS], SOME_TIME,
        ),
        (
            replace(SMALL, models="none"), "S0", "evolve one skill for each of S0",
            "domain tabletop, seed 6", WORLD, SOME_TIME,
        ),
        (CART, AUTO, UNTIL_MET, "domain mine:Cart, seed 0",
         IMAGINED, TEN_MINUTES),
        (replace(CART, models="none"), AUTO, UNTIL_MET,
         "domain mine:Cart, seed 0", REWARDED, TEN_MINUTES),
        (replace(CART, models="none", method="paper"), AUTO,
         UNTIL_MET, "domain mine:Cart, seed 0", WORLD,
         TEN_MINUTES),
    ],
)  # fmt: skip
def test_a_new_run_says_what_it_will_do(
    settings: RunSettings, stage: str, until: str, about: str, steps: list[str], takes: str
) -> None:
    run = planned(settings)
    assert list(_before(work(run, stage))) == [
        f"New run runs/one: {until} ({about}).",
        *steps,
        takes,
        "    tensorboard --logdir runs/one",
        f"  Ctrl-C stops the run, and this command continues it: {resuming(run)}",
    ]


def test_the_command_that_continues_a_run_names_the_users_code() -> None:
    run = planned(SMALL)
    assert resuming(run) == "cgtorch-train --resume runs/one"
    own = replace(run.settings, actions=("Wait", "a:B", "c.d:E"), driver="my:Arm", domain="me:Own")
    assert resuming(replace(run, settings=own)) == (
        "cgtorch-train --resume runs/one --domain me:Own --actions a:B --actions c.d:E "
        "--driver my:Arm"
    )


def test_commands_can_be_pasted_whatever_the_folder_is_called(trained: Trained) -> None:
    made = work(replace(read_run(trained.folder), folder=Path("my run (1) ü")), "S2")
    said = [*_before(made), *_after(made)]
    commands = [line for line in said if "cgtorch-" in line or "tensorboard " in line]
    assert len(commands) > 4
    assert all(" 'my run (1) ü'" in line for line in commands)
    made = work(replace(made.run, folder=Path("-new")), "S2")
    said = [*_before(made), *_after(made)]
    commands = [line for line in said if "cgtorch-" in line or "tensorboard " in line]
    assert all(" ./-new" in line for line in commands)


def test_it_is_said_how_a_run_ended(trained: Trained, monkeypatch: pytest.MonkeyPatch) -> None:
    run = read_run(trained.folder)
    plain = work(run, "S1")
    assert _end(plain, []) == "is complete up to S1"
    rounds = replace(work(run), run=planned(SMALL))
    assert _end(rounds, []) == "has not finished its first round in time; continue with --resume"
    monkeypatch.setattr(training, "advice_after", lambda run: "give rewards")
    monkeypatch.setattr(StoredRun, "rounds", ("auto-1",))
    missed = "has not reached its goal of 0.99; give rewards"
    assert _end(work(planned(SMALL)), [{"stage": "auto-1", "fresh": None}]) == missed
    spent = work(run, limits={"actions": 1500.0, "looks": 5.0})
    spent.purse.exhausted = True
    said = "has spent its budget of 1500 actions and 5 looks; {}; continue with --resume and more"
    assert _end(spent, []).startswith(said.format("there is no skill yet"))
    told = [{"stage": "S0"}, {"stage": "S1"}]
    assert _end(spent, told).startswith(said.format("the best skill is S1"))
    spent.purse.until = 0.0  # it is the time that is over
    assert _end(replace(spent, stage="S1"), told) == "is complete up to S1"


@pytest.mark.parametrize("met", [True, False])
def test_it_is_said_whether_the_goal_was_reached(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, met: bool
) -> None:
    run = read_run(copied(trained, tmp_path / "run"))
    (run.folder / "S1").rename(run.folder / "auto-1")
    asked = list[Any]()
    monkeypatch.setattr(training, "reached", lambda goal, rows: asked.append(rows) or met)
    said = "has reached its goal of 0.99" if met else (
        "has not reached its goal of 0.99; continue with --resume"
    )  # fmt: skip
    rows = [{"stage": "S0"}, {"stage": "auto-1"}]
    assert _end(work(run), rows) == said
    assert asked == [rows[1:]]  # of the rounds alone


def test_after_a_run_it_is_said_what_to_look_at(trained: Trained) -> None:
    run = read_run(trained.folder)
    folder = trained.folder
    lines = [
        "Next:",
        f"  cgtorch-evaluate {folder}  # try the skill on fresh scenarios",
        f"  cgtorch-view {folder}  # watch it at work in the browser",
        f"  cgtorch-report {folder} --output report.html  # the run, and where it fails",
    ]
    assert list(_after(work(run))) == lines
    more = f"  cgtorch-train --resume {folder} --stage S3  # more stages"
    assert list(_after(work(run, "S1"))) == [*lines, more]
    robot = replace(run, settings=replace(run.settings, driver="my:Arm"))
    assert list(_after(work(robot))) == [lines[0], lines[1], lines[3]]


def test_what_became_of_additional_actions_is_said(trained: Trained) -> None:
    run = read_run(trained.folder)
    names = run.actions.names
    used = "Grasp"

    class Fewer(type(run.domain)):  # type: ignore[misc]
        def actions(self) -> Any:
            return run.actions.__class__(names[:2], run.actions.actions[:2])

    domain = Fewer(run.domain.settings)
    found = list(_after(work(replace(run, domain=domain))))[: len(names) - 2]
    assert f"S1 uses the action {used}." in found
    assert found == sorted(found, key=lambda line: line.split("is ")[-1].split("action ")[-1])
    unused = [line for line in found if line.startswith("No node of S1 is ")]
    assert all(
        line.endswith(": the search found no use for it. Another --seed may.") for line in unused
    )


@pytest.mark.parametrize(
    ("cores", "population", "lanes", "processes"),
    [(1, 400, 64, 1), (3, 400, 64, 3), (9, 24, 64, 6), (9, 3, 64, 1), (9, 24, 1, 1)],
)
def test_processes_are_as_many_as_have_something_to_do(
    monkeypatch: pytest.MonkeyPatch, cores: int, population: int, lanes: int, processes: int
) -> None:
    monkeypatch.setattr(ranks, "cores", lambda: cores)
    monkeypatch.setattr(training, "most_lanes", lambda domain: lanes)
    run = planned(replace(SMALL, models="none", population=population))
    assert usual_processes(run) == processes
    assert usual_processes(replace(run, repeats=False)) == 1
    assert usual_processes(planned(replace(SMALL, population=population))) == 1
    monkeypatch.setattr(training, "most_lanes", lambda domain: None)
    assert usual_processes(run) == 1
