"""Training from Python: a run as an object, the same as by the command."""

import importlib.util
import math
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from driven_cart import CartDriver

import cgtorch
from cgtorch.commands.train import command
from cgtorch.graphs import merged
from cgtorch.ground.errors import CgtorchError, DomainError, RunError, SettingsError
from cgtorch.improvement.events import Event, GenerationDone, SkillAccepted

SMALL: dict[str, Any] = {"population": 40, "generations": 10, "practice": 10}
CART = Path(__file__).parents[2] / "examples" / "cart.py"
REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


@pytest.fixture(scope="module")
def cart() -> Iterator[Any]:
    """The module of the example's cart, as one that a program has imported."""
    about = importlib.util.spec_from_file_location("a_cart", CART)
    assert about is not None
    assert about.loader is not None
    module = importlib.util.module_from_spec(about)
    sys.modules["a_cart"] = module
    about.loader.exec_module(module)
    yield module
    del sys.modules["a_cart"]


def trained(domain: Any, folder: Path, **more: Any) -> cgtorch.Run:
    return cgtorch.train(domain, folder, quiet=True, rounds=1, **{**SMALL, **more})


def test_a_run_from_python_is_that_of_the_command(tmp_path: Path) -> None:
    run = cgtorch.train("tabletop", tmp_path / "a", stage="S0", quiet=True, seed=3, **SMALL)
    options = [f"--{name}={value}" for name, value in SMALL.items()]
    words = ["--stage", "S0", "--seed=3", f"--run-dir={tmp_path / 'b'}", *options]
    assert CliRunner().invoke(command, words).exit_code == 0
    other = cgtorch.open_run(tmp_path / "b")
    assert run.all_settings() == other.all_settings()
    assert torch.equal(run.skill.graph.parameters, other.skill.graph.parameters)
    assert [row["event"] for row in run.log()] == [row["event"] for row in other.log()]


@pytest.fixture(scope="module")
def whole(cart: Any, tmp_path_factory: pytest.TempPathFactory) -> cgtorch.Run:
    """A run of one round; the last test makes more of it."""
    return trained(cart.Cart, tmp_path_factory.mktemp("whole") / "run")


def test_a_run_tells_all_that_it_has(whole: cgtorch.Run, tmp_path: Path) -> None:
    run = whole
    assert run.stages == ("auto-1",)
    assert list(run.skills) == ["auto-1"]
    assert run.skill.name == run.ledger[-1]["skill"] == "auto-1"
    assert run.results[0]["stage"] == "auto-1"
    score = run.evaluate(50, seed=4)
    assert score.tried == 50
    assert score.successes == run.evaluate(50, seed=4, skill=run.skills["auto-1"]).successes > 25
    run.report(tmp_path / "page.html")
    assert b"auto-1" in (tmp_path / "page.html").read_bytes()
    assert run.log()[0]["event"] == "asked"


def test_a_report_replaces_no_file_unasked_and_never_one_of_the_run(
    whole: cgtorch.Run, tmp_path: Path
) -> None:
    page, log = tmp_path / "page.html", whole.folder / "log.jsonl"
    page.write_text("precious")
    before = log.read_bytes()
    with pytest.raises(RunError, match="exists; choose another path or give force=True"):
        whole.report(page)
    assert page.read_text() == "precious"
    for part in (log, whole.folder / "auto-1" / "skill.json"):
        with pytest.raises(RunError, match=r"is a part of the run .*; choose another path"):
            whole.report(part, force=True)
    with pytest.raises(RunError, match=r"'.' is a folder; choose another path"):
        whole.report(".")
    assert log.read_bytes() == before
    whole.report(page, force=True)
    assert b"auto-1" in page.read_bytes()


@pytest.mark.parametrize("part", ["run.json", "log.jsonl", "auto-1/skill.json"])
def test_neither_a_skill_nor_a_search_replaces_a_file_of_a_run(
    part: str, whole: cgtorch.Run
) -> None:
    path = whole.folder / part
    before = path.read_bytes()
    search = cgtorch.Search(whole.actions, population=6)
    for write in (search.save, lambda path: cgtorch.save_skill(path, whole.skill)):
        with pytest.raises(RunError, match=r"is a part of the run .*; choose another path"):
            write(path)
    assert path.read_bytes() == before


def test_a_run_stays_the_same_in_another_folder(
    cart: Any, whole: cgtorch.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(whole.folder.parent)
    run = cgtorch.open_run(whole.folder.name, cart.Cart)
    begun = cgtorch.train("tabletop", "begun", stage="S0", quiet=True, watch=lambda event: True)
    monkeypatch.chdir(tmp_path)
    assert (run.stages, len(run.log())) == (("auto-1",), len(whole.log()))
    assert begun.log()
    begun.resume(quiet=True, watch=lambda event: True)
    assert not list(tmp_path.iterdir())


UNSEEN = """
import cgtorch
run = cgtorch.train("tabletop", "run", stage="S0", population=40, watch=lambda event: True)
print(run.settings.population, run.resume(watch=lambda event: True).stages)
"""


@pytest.mark.hostile
def test_a_program_goes_on_when_nobody_reads_its_progress(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-c", UNSEEN], cwd=tmp_path, stdout=subprocess.PIPE, stderr=write
    )
    os.close(write)
    assert (done.returncode, done.stdout) == (0, b"40 ()\n")


def test_the_reference_run_tells_all_that_it_has() -> None:
    run = cgtorch.open_run(REFERENCE)
    assert list(run.skills) == [row["stage"] for row in run.ledger] == list(run.stages)
    assert {row["event"] for row in run.ledger} == {"accepted"}
    last = run.skills[run.stages[-1]]
    assert torch.equal(run.skill.graph.parameters, last.graph.parameters)
    one, other = run.evaluate(20, seed=1), run.evaluate(20, seed=2)
    assert torch.equal(one.succeeded, run.evaluate(20, run.kind, 1, last).succeeded)
    assert not torch.equal(one.percepts, other.percepts)
    assert run.evaluate(20, "near", 1).successes >= 15
    first = run.evaluate(20, "perimeter", 1, run.skills["S0"])
    assert first.successes < run.evaluate(20, "perimeter", 1).successes


def test_a_run_its_domain_and_a_world_can_be_pickled() -> None:
    run, domain = cgtorch.open_run(REFERENCE), cgtorch.make("tabletop")
    world = domain.world(domain.tests("near"))
    parts = pickle.loads(pickle.dumps((run, domain, world)))  # noqa: S301  they are one's own
    other, second, place = parts
    assert torch.equal(run.evaluate(20).succeeded, other.evaluate(20).succeeded)
    assert (second.settings, place.num_scenarios) == (domain.settings, world.num_scenarios)


@pytest.mark.parametrize("quiet", [True, False])
def test_progress_is_shown_unless_it_is_not_wanted(
    quiet: bool, cart: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    how: dict[str, Any] = {"watch": lambda event: True, **({"quiet": True} if quiet else {})}
    run = cgtorch.train(cart.Cart, folder, **SMALL, rounds=1, **how)
    assert bool("".join(capfd.readouterr())) is not quiet
    run.resume(**how)
    assert bool("".join(capfd.readouterr())) is not quiet


def test_a_domain_is_an_object_a_class_or_a_name(cart: Any, tmp_path: Path) -> None:
    local = type("Local", (cart.Cart,), {"__qualname__": "f.<locals>.Local"})
    for i, domain in enumerate((cart.Cart, cart.Cart(), "a_cart:Cart", local)):
        folder = tmp_path / str(i)
        run = trained(domain, folder, watch=lambda event: True)  # which stops at once
        assert cgtorch.open_run(folder, domain).all_settings() == run.all_settings()
        with pytest.raises(CgtorchError, match="code of its own"):
            cgtorch.open_run(folder)


PROGRAM = """
if __name__ == "__main__":
    import cgtorch
    run = cgtorch.train(Cart, "run", quiet=True, watch=lambda event: True, population=40)
    assert type(run.domain) is Cart  # the program was not imported a second time
    print(run.settings.domain, cgtorch.open_run("run", Cart).settings.domain)
"""


@pytest.mark.hostile
def test_another_program_opens_a_run_of_a_domain_in_a_program(tmp_path: Path) -> None:
    """The run remembers the file in place of `__main__`, which is another one each time."""
    (tmp_path / "driving.py").write_text(CART.read_text() + PROGRAM)
    opening = "import cgtorch, driving; print(cgtorch.open_run('run', driving.Cart).kind)"
    for words, said in ((["driving.py"], "driving:Cart driving:Cart"), (["-c", opening], "any")):
        done = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.stdout.strip() == said, done.stderr


def test_a_watch_sees_champions_and_may_stop_a_run_which_resumes(
    cart: Any, whole: cgtorch.Run, tmp_path: Path
) -> None:
    """The run that was stopped goes on to the same skill."""
    told: list[Event] = []

    def until_fourth(event: Event) -> bool:
        told.append(event)
        return sum(isinstance(each, GenerationDone) for each in told) == 4

    run = trained(cart.Cart(), tmp_path / "run", watch=until_fourth)
    assert not run.stages
    generations = [each.generation for each in told if isinstance(each, GenerationDone)]
    assert [len(each.champion) for each in generations] == [1] * 4
    fittest = max(generations, key=lambda each: each.best)
    assert run.skill.num_nodes == int(merged(fittest.champion.graphs).num_nodes)
    run = run.resume(quiet=True, watch=lambda event: told.append(event) or "only True stops")
    assert any(isinstance(event, SkillAccepted) for event in told)
    assert torch.equal(run.skill.graph.parameters, whole.skill.graph.parameters)


def test_a_run_that_has_just_begun_has_no_skill(tmp_path: Path) -> None:
    about: dict[str, Any] = {"stage": "S0", "quiet": True, "watch": lambda event: True}
    run = cgtorch.train("tabletop", tmp_path / "run", **about)
    assert run.skills == {}
    with pytest.raises(RunError, match="has no skill yet; resume it"):
        _ = run.skill


def test_settings_of_the_domain_belong_to_it(tmp_path: Path) -> None:
    domain = cgtorch.make("tabletop", position_noise=0.01)
    assert domain.settings.position_noise == 0.01
    with pytest.raises(SettingsError, match="robot is a setting of the domain, which is made"):
        cgtorch.train(domain, tmp_path / "run", robot="fetch")
    cartpole = cgtorch.make("gymnasium:CartPole-v1", target_return=100.0)
    assert math.isclose(cartpole.target_return, 100.0)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"populaton": 3}, SettingsError, "unknown setting 'populaton'; did you mean 'population'"),
        ({"position_nose": 3}, SettingsError, "did you mean 'position_noise'"),
        ({"population": "many"}, SettingsError, "population is 'many'; give a whole number"),
        ({"target": 2.0}, SettingsError, "target is 2, which is no share"),
        ({"target": 0.0}, SettingsError, "target is 0, which is no share"),
        ({"target": 1.0}, SettingsError, "give a number above 0, up to 0.999"),
        ({"budget": {"grasps": 3}}, SettingsError, "budget grasps=3 is no limit"),
        ({"device": "abacus"}, SettingsError, "device 'abacus' cannot be used"),
        ({"stage": "S9"}, SettingsError, "unknown stage 'S9'"),
        ({"domain": 3}, DomainError, "domain is 3; give a name"),
        ({"domain": "CartPole-v1"}, DomainError, "such as 'gymnasium:CartPole-v1'$"),
        ({"domain": gymnasium.Env}, DomainError, "such as 'gymnasium:CartPole-v1'$"),
        ({"domain": gymnasium.make("Acrobot-v1")}, DomainError, "such as 'gymnasium:Acrobot-v1'$"),
        ({"budget": {"motions": 1.5}}, SettingsError, "budget motions=1.5 is no limit; give whole"),
        ({"domain": "table"}, DomainError, "unknown domain 'table'"),
        ({"actions": ["Fly"]}, CgtorchError, "unknown action 'Fly'"),
        ({"actions": "Wait"}, SettingsError, "the text 'Wait', not a list of names; give a"),
        ({"actions": [3]}, SettingsError, r"actions is \[3\]; give a list of names or classes"),
        ({"actions": None}, SettingsError, "actions is None; give a list of names or classes"),
        ({"budget": "motions=3"}, SettingsError, "budget is 'motions=3'; give limits by name"),
        ({"budget": {"motions": "3"}}, SettingsError, "budget motions='3' is no limit"),
        ({"checkpoint_seconds": "x"}, SettingsError, "checkpoint_seconds is 'x'; give a number"),
        (
            {"checkpoint_seconds": math.nan},
            SettingsError,
            "checkpoint_seconds is nan; give a number",
        ),
        ({"device": 5}, SettingsError, "device is 5; give auto, cpu or cuda"),
        ({"watch": 3}, SettingsError, "watch is 3; give a function"),
        ({"quiet": "no"}, SettingsError, "quiet is 'no'; give True or False"),
        ({"folder": 5}, SettingsError, "folder is 5; give a path as a text or a pathlib.Path"),
        ({"folder": b"x"}, SettingsError, "folder is b'x'; give a path"),
        ({"folder": "a\0b"}, SettingsError, "which no file can be called; give another"),
        ({"folder": "x" * 256}, SettingsError, "is too long; give names of at most 255 bytes"),
    ],
)
def test_what_cannot_work_is_said_before_anything_is_written(
    given: dict[str, Any], error: type[CgtorchError], message: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=message):
        cgtorch.train(**{"domain": "tabletop", "folder": tmp_path / "run", "quiet": True, **given})
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", [None, 3, object, cgtorch.Domain])
def test_what_is_no_name_makes_no_domain(name: Any) -> None:
    with pytest.raises(SettingsError, match=r"name is .*; give the name of a domain, such as"):
        cgtorch.make(name)


def test_a_run_whose_first_stage_is_lost_says_so(tmp_path: Path) -> None:
    shutil.copytree(REFERENCE, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "S0")
    with pytest.raises(RunError, match="has S1, but not S0, on which it builds; restore the"):
        _ = cgtorch.open_run(tmp_path / "run").skill


@pytest.mark.parametrize("folder", [None, 5, b"x", ["runs/a"]])
def test_what_is_no_path_is_no_run(folder: Any) -> None:
    with pytest.raises(SettingsError, match=r"folder is .*; give a path as a text or a pathlib"):
        cgtorch.open_run(folder)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": -1}, "count is -1; give a whole number from 0 to 1000000"),
        ({"count": 10**9}, "count is 1000000000; give a whole number from 0 to 1000000"),
        ({"count": "ten"}, "count is 'ten'; give a whole number"),
        ({"count": 2.5}, "count is 2.5; give a whole number"),
        ({"count": 5, "seed": 1.5}, "seed is 1.5; give a whole number"),
        ({"count": 5, "skill": "best"}, "skill is 'best'; give a Skill"),
    ],
)
def test_what_cannot_be_tried_is_said(given: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        cgtorch.open_run(REFERENCE).evaluate(**given)


def test_what_is_no_score_has_no_failures() -> None:
    number: Any = 5
    with pytest.raises(SettingsError, match="score is 5; give a Score, such as evaluate returns"):
        cgtorch.open_run(REFERENCE).failures(number)


def test_a_watch_is_checked_before_a_run_goes_on(whole: cgtorch.Run) -> None:
    watch: Any = 3
    with pytest.raises(SettingsError, match="watch is 3; give a function"):
        whole.resume(watch=watch)


def test_whole_numbers_of_numpy_are_settings_too(cart: Any, tmp_path: Path) -> None:
    about: dict[str, Any] = {"population": np.int64(40), "seed": np.int32(1), "quiet": True}
    run = cgtorch.train(cart.Cart, tmp_path / "run", watch=lambda event: True, **about)
    assert cgtorch.open_run(run.folder, cart.Cart).settings.population == 40


def test_a_robot_is_trained_and_goes_on(tmp_path: Path) -> None:
    """The driver's class is the domain; its budget ends the run, which asks no more than that."""
    about = {"generations": 8, "practice": 4, "budget": {"motions": 60, "tests": 60}}
    run = trained(CartDriver, tmp_path / "run", **about)
    first = [row for row in run.log() if row["event"] == "action"]
    assert 20 < len(first) <= 120
    again = run.resume(quiet=True, rounds=2, budget={"motions": 80, "tests": 80})
    later = [row for row in again.log() if row["event"] == "action"]
    assert later[: len(first)] == first
    assert len(first) <= len(later) <= 160
    assert len(again.stages) >= len(run.stages)


@pytest.mark.hostile
def test_a_run_resumes_with_more(whole: cgtorch.Run) -> None:
    run = whole
    more = run.resume(quiet=True, rounds=2, target=0.999, population=41)
    assert more.settings.population == 41
    assert more.stages[0] == "auto-1"
    with pytest.raises(SettingsError, match="did you mean 'population'"):
        run.resume(quiet=True, populaton=5)
    with pytest.raises(SettingsError, match=r"seed 0 of run .* cannot become 5"):
        run.resume(quiet=True, seed=5)
