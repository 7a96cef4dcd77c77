"""`--data` and `--format data`: a run learns from a file alone, and needs it only once."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from click.testing import CliRunner
from command_line import EVALUATE, EXPORT, REPORT, ROOT, TRAIN, Shell, about, listing
from told_by_runs import asked_at_start, result_of
from torch import Generator

from cgtorch import read_data
from cgtorch.commands import export, train
from cgtorch.domains.exploration import FEWEST, LEAST
from cgtorch.domains.knowledge import MOST_LABELS, MOST_TRANSITIONS
from cgtorch.ground.environment import Dataset
from cgtorch.runs.chosen import stored_data
from examples.cart import Cart, Rail

PAGE = ROOT / "docs" / "data.md"
DOMAIN = "examples.cart:Cart"
CART = ["--domain", DOMAIN]
QUICK = ["--population=60", "--generations=20", "--practice=10", "--rounds=1", "--quiet"]
ONLY_MODELS = [*QUICK, "--minutes=0"]
ALONE = ["--data", "log.csv", "--transitions", "0"]
ONE = "place,wind,push,next place,next wind,succeeded\n0,0,0.5,0.5,0,\n"


def same(one: Dataset, other: Dataset) -> bool:
    pairs = zip(vars(one).values(), vars(other).values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def asked(part: Path) -> dict[str, Any]:
    if part.name == "start":
        return asked_at_start(part.parent)
    found: dict[str, Any] = result_of(part.parent, part.name)["asked"]
    return found


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of carts, and with its data in a file."""
    folder = tmp_path_factory.mktemp("logged")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command, words in (
            (train.command, [*CART, *QUICK, "--run-dir", "first"]),
            (export.command, ["first/start", *CART, "--format", "data", "--output", "log.csv"]),
        ):
            told = CliRunner().invoke(command, words)
            assert told.exit_code == 0, told.output
    return folder


@pytest.fixture
def logged(made: Path, tmp_path: Path) -> Path:
    """A copy of that, to be changed."""
    return Path(shutil.copytree(made, tmp_path, dirs_exist_ok=True))


def data_of(logged: Path, run: str = "second", part: str = "start") -> Dataset:
    return stored_data(logged / run, part, domain=DOMAIN)[2]


@pytest.mark.hostile
def test_a_run_from_a_file_alone(shell: Shell, logged: Path) -> None:
    words = [TRAIN, *CART, *QUICK, *ALONE, "--run-dir", "second", "--seed", "5"]
    shell.does(*words)
    assert asked(logged / "second" / "start") == {}
    assert "exploration" not in asked(logged / "second" / "auto-1")
    assert asked(logged / "second" / "auto-1")["practice"]["motions"] > 0
    assert same(read_data("log.csv", Cart.percept, Cart.control), data_of(logged))

    (logged / "log.csv").unlink()  # from here on nothing needs it
    shell.does(*words)
    shell.does(TRAIN, *CART, "--resume", "second", "--quiet", "--rounds", "2")
    assert shell.told(EVALUATE, "second", *CART, "--count", "100")["succeeded"] >= 80
    shell.does(REPORT, "second", *CART, "--output", "page.html")
    text = (logged / "page.html").read_text()
    assert "--transitions 0" in text
    assert "--data log.csv" in text


def test_a_file_is_enough_where_the_world_may_not_be_asked(shell: Shell, logged: Path) -> None:
    """Not even for a look; the models have the last word on the skill."""
    nothing = "motions=0,tests=0,looks=0"
    shell.does(TRAIN, *CART, *QUICK, *ALONE, "--budget", nothing, "--run-dir", "second")
    part = logged / "second" / "auto-1"
    for counts in asked(part).values():  # an episode that cannot begin asks for nothing
        assert not counts["motions"] + counts["tests"] + counts["looks"]
    assert json.loads((part / "scenarios.json").read_text())["chance"] is False
    found = shell.told(EVALUATE, "second", *CART, "--count", "100")
    assert found["succeeded"] > 0  # of carts, which no trial has corrected


def test_exploration_goes_on_from_a_file(shell: Shell, logged: Path) -> None:
    """As it would after an interruption: what is known is not explored again."""
    given = read_data("log.csv", Cart.percept, Cart.control)
    lines = (logged / "log.csv").read_text().splitlines()
    few = [line for line in lines if line[-1] == ","][:8]
    (logged / "few.csv").write_text("\n".join([lines[0], *few]))
    shell.does(TRAIN, *CART, *ONLY_MODELS, "--data", "few.csv", "--run-dir", "second")
    known = data_of(logged).percept
    assert torch.equal(known[:8], given.percept[:8])
    assert asked(logged / "second" / "start")["exploration"]["motions"] == len(known) - 8


def test_several_files(shell: Shell, logged: Path) -> None:
    words = ["--data", "log.csv", "--data", "log.csv", "--transitions=0", "--run-dir", "second"]
    shell.does(TRAIN, *CART, *ONLY_MODELS, *words)
    given = read_data("log.csv", Cart.percept, Cart.control)
    assert len(data_of(logged).percept) == 2 * len(given.percept)
    assert about(logged / "second")["settings"]["data"] == ["log.csv", "log.csv"]
    message = shell.refuses(TRAIN, *CART, *ONLY_MODELS, *ALONE, "--run-dir", "second")
    assert "has data ['log.csv', 'log.csv'], not ['log.csv'], and cannot change it, as" in message
    message = shell.refuses(TRAIN, *CART, "--resume", "second", "--override", "data=x.csv")
    assert "data ['log.csv', 'log.csv'] of run 'second' cannot become" in message


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--transitions", "0"], "transitions is 0, and there is nothing else to learn Γ and C"),
        (["--transitions", "5"], "transitions is 5; give a whole number of at least 12 or 0"),
        (["--transitions", "-1"], "transitions is -1; give a whole number of at least 12 or 0"),
        (["--data", "none.csv"], "cannot read 'none.csv', which is not a file; check the path"),
        (["--data", ""], "has no main_data.hdf5; give the folder of a Minari dataset"),
        (["--data", "."], "'.' has no main_data.hdf5"),
        (["--data", "log.txt"], "'log.txt' is of no known format"),
        (["--data", "log.csv", "--data", "none.csv"], "cannot read 'none.csv'"),
        (ALONE, "the data have 1 transitions, 0 tests that succeeded and 0 that failed"),
        (
            [*ALONE, "--models", "none"],
            "Γ and C are learned from data (--data), and",
        ),
        (["--data", "bad.csv"], "'push' in line 2 of 'bad.csv' is 'x'; give a finite number"),
    ],
)
def test_bad_data(shell: Shell, tmp_path: Path, words: list[str], says: str) -> None:
    """They are refused before anything is written."""
    (tmp_path / "log.csv").write_text(ONE)
    (tmp_path / "bad.csv").write_text(ONE.replace("0.5", "x", 1))
    assert says in shell.refuses(TRAIN, *CART, *words, "--run-dir", "run")
    assert listing(tmp_path) == {"log.csv", "bad.csv"}


def test_data_of_another_domain(shell: Shell, logged: Path) -> None:
    before = listing(logged)
    message = shell.refuses(TRAIN, *ALONE, "--stage", "auto", "--run-dir", "second")
    assert "'log.csv' lacks columns 'table x min', 'table x max'" in message
    assert listing(logged) == before


@pytest.mark.parametrize("output", ["a.csv", "a.parquet"])
def test_all_data_of_a_run_are_exported(shell: Shell, logged: Path, output: str) -> None:
    for words, part in (
        (["first"], "auto-1"),
        (["first/auto-1"], "auto-1"),
        (["first", "--skill", "start"], "start"),
        (["first/start"], "start"),
    ):
        ended = shell.does(EXPORT, *words, *CART, "--format=data", "--output", output, "--force")
        found = read_data(logged / output, Cart.percept, Cart.control)
        moves, tests = len(found.percept), len(found.tested)
        said = f"data of {part}: {output}, {moves} transitions and {tests} tests\n"
        assert (ended.out, ended.err) == (said, "")
        assert same(found, data_of(logged, "first", part))
    if output.endswith(".csv"):
        assert (logged / output).read_text().startswith("place [m],wind [m],push [m],next place [")


def test_what_was_set_aside_is_exported_too(shell: Shell, logged: Path) -> None:
    start = logged / "first" / "start"
    shutil.copy(start / "data.safetensors", start / "aside.safetensors")
    words = [EXPORT, start, *CART, "--format", "data", "--output", "a.csv"]
    shell.does(*words)
    once = read_data("log.csv", Cart.percept, Cart.control)
    assert same(read_data("a.csv", Cart.percept, Cart.control), once.extended(once))
    message = shell.refuses(*words)
    assert "'a.csv' exists; choose another --output or add --force" in message


def test_the_page_about_data(logged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its table can be read, and its program runs."""
    monkeypatch.chdir(logged)
    text = PAGE.read_text()
    ((table,), (program,)) = (
        re.findall(rf"^```{kind}\n(.*?)^```", text, re.M | re.S) for kind in ("text", "python")
    )
    (logged / "page.csv").write_text(table)
    found = read_data("page.csv", Cart.percept, Cart.control)
    assert torch.equal(found.next_percept, found.tested)
    assert (
        found.succeeded.tolist()
        == Rail(Cart().draw("any", 1, Generator())).succeeded(found.tested).tolist()
        == [False, True]
    )
    left = dict[str, Any]()
    exec(compile(program, "data.md", "exec"), left)  # noqa: S102
    assert same(read_data("copy.parquet", Cart.percept, Cart.control), left["data"])
    for number, name in ((MOST_TRANSITIONS, "transitions"), (MOST_LABELS, "tests")):
        assert f"{number:,} {name}" in text
    assert f"At least {LEAST} transitions are needed, and {FEWEST} tests of either result" in text


def test_what_has_no_data(shell: Shell, logged: Path) -> None:
    shutil.copytree(logged / "first", logged / "bare")
    for path in (logged / "bare").rglob("data.safetensors"):
        path.unlink()
    before = listing(logged)
    for words, says in (
        (["bare"], "'bare/auto-1' has no data: the run is stored without them, or no models"),
        (["first", "--skill", "S7"], "run 'first' has no part 'S7'; give one of start, auto-1"),
        (["first", "--skill", "../x"], "run 'first' has no part '../x'; give one of start, auto"),
        (["first/by_rows"], "has no part 'by_rows'; give one of start, auto-1"),
        (["first/auto-1/skill.json"], "'first/auto-1/skill.json' is no run"),
        (["log.csv"], "'log.csv' is no run"),
        (["none"], "'none' is no run"),
    ):
        message = shell.refuses(EXPORT, *words, *CART, "--format", "data", "--output", "a.csv")
        assert says in message
    message = shell.refuses(EXPORT, "first", *CART, "--format", "data", "--output", "a.txt")
    assert "--output is 'a.txt'; give a name that ends in .csv or .parquet for --format" in message
    assert listing(logged) == before
