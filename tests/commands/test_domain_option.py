"""`--domain`: a domain of one's own from its settings to its report, and what is no domain."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import (
    EVALUATE,
    EXPORT,
    REPORT,
    TRAIN,
    VIEW,
    Shell,
    about,
    edited,
    in_a_shell,
    listing,
)
from own_domains import EXAMPLE, IMPORTED, OWN_CART
from told_by_runs import result_of
from trained import Trained, copied

CART = ["--domain", "own_cart:Cart"]
SMALL = [
    *("--population=40", "--generations=10", "--attempts=4", "--practice=10", "--transitions=100"),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the module of a domain, and a run about it up to its first stage."""
    folder = tmp_path_factory.mktemp("carts")
    (folder / "own_cart.py").write_text(OWN_CART + IMPORTED)
    words = ["--stage", "up", "--run-dir", "run", "--wind", "0.1", *SMALL]
    ended = in_a_shell(TRAIN, *CART, *words, folder=folder)
    assert ended.code == 0, ended.err
    (folder / "imported").unlink()
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    return folder


@pytest.fixture
def carts(made: Path, tmp_path: Path) -> Path:
    """A copy of that, to be changed."""
    return Path(shutil.copytree(made, tmp_path, dirs_exist_ok=True))


def test_settings_of_the_domain_are_kept(made: Path) -> None:
    found = about(made / "run")
    assert found["settings"]["domain"] == "own_cart:Cart"
    assert found["domain_settings"] == {"wind": 0.1, "colour": "red"}
    assert found["goes_on_to"] == {"stage": "up"}
    result = result_of(made / "run", "up")
    assert (result["stage"], result["scenarios"]) == ("up", "calm")
    assert result["fresh"]["succeeded"] > 20


def test_every_command_knows_what_it_is_about(shell: Shell, carts: Path) -> None:
    words = [*CART, "--scenarios", "windy", "--count", "20"]
    found = shell.told(EVALUATE, "run", *words)
    assert (found["skill"], found["scenarios"], found["tried"]) == ("up", "windy", 20)
    shell.told(EVALUATE, "run/up/skill.json", *words)
    shell.does(EXPORT, "run", *CART, "--format", "json", "--output", "up.json")
    assert (carts / "up.json").read_bytes() == (carts / "run/up/skill.json").read_bytes()
    assert shell.does(REPORT, "run", *CART, "--output", "page.html").err == ""
    assert "own_cart:Cart" in (carts / "page.html").read_text()
    assert "run run is complete up to up" in shell.does(TRAIN, "--resume", "run", *CART).err


@pytest.mark.parametrize(
    "words",
    [
        (TRAIN, "--resume", "run"),
        (EVALUATE, "run"),
        (EVALUATE, "run/up"),
        (EVALUATE, "run", "--skill", "up"),
        (EXPORT, "run", "--format", "json", "--output", "x"),
        (REPORT, "run", "--output", "x"),
    ],
)
def test_code_is_not_imported_because_a_run_names_it(
    shell: Shell, carts: Path, words: tuple[str, ...]
) -> None:
    before = listing(carts)
    assert (
        "run 'run' is about domain 'own_cart:Cart', which is code of its own; if you trust it, "
        "give it as domain (--domain own_cart:Cart)"
    ) in shell.refuses(*words).replace(str(carts) + "/", "")
    assert "is about domain 'own_cart:Cart', not 'tabletop'" in shell.refuses(
        *words, "--domain", "tabletop"
    )
    assert listing(carts) == before


def test_a_domain_is_not_imported_to_watch_it_unless_it_is_trusted(
    shell: Shell, carts: Path
) -> None:
    for place in ("run", "run/up"):
        message = shell.refuses(VIEW, place)
        assert "is about domain 'own_cart:Cart', which is code of its own; if you trust" in message
    assert not (carts / "imported").exists()


def test_a_run_that_begun_about_another_domain(shell: Shell, carts: Path) -> None:
    before = (carts / "run" / "run.json").read_bytes()
    assert "is about domain 'own_cart:Cart', not 'tabletop'" in shell.refuses(
        TRAIN, "--run-dir", "run"
    )
    message = shell.refuses(TRAIN, *CART, "--run-dir", "run", "--wind", "0.3", *SMALL)
    assert "has wind 0.1, not 0.3, and cannot change it, as the domain was made with" in message
    message = shell.refuses(TRAIN, *CART, "--resume", "run", "--override", "wind=0.3")
    assert "wind 0.1 of run 'run' cannot become 0.3, as the domain was made with it" in message
    assert (carts / "run" / "run.json").read_bytes() == before


NEVER = """

class Never(Cart):
    \"\"\"One in which success is never met.\"\"\"

    def world(self, scenarios):
        world = super().world(scenarios)
        world.succeeded = lambda state: state[:, 0] > 9
        return world
"""


def test_a_run_that_had_nothing_to_learn_is_begun_anew(shell: Shell, tmp_path: Path) -> None:
    """The message says with which settings, so these are taken in the same folder."""
    (tmp_path / "never_cart.py").write_text(EXAMPLE + NEVER)
    words = [*("--domain", "never_cart:Never", "--run-dir", "run", "--quiet"), *SMALL]
    message = shell(TRAIN, *words).err
    assert re.search(r"success was missed in (\d+) of \1 tests of \d+ motions", message)
    assert message.endswith("or evolve in the world: models 'none' (--models none)\n")
    shell(TRAIN, *words, "--models", "none")
    assert about(tmp_path / "run")["settings"]["models"] == "none"
    (tmp_path / "run" / "auto-1").mkdir()  # from here on there is something to lose
    message = shell.refuses(TRAIN, *words, "--models", "learned")
    assert "has models none, not learned, and cannot change it" in message


DAMAGED: list[Any] = [
    None,
    3,
    [],
    {},
    {"wind": 0.1},
    {"wind": 0.1, "colour": "red", "size": 1},
    {"wind": "much", "colour": "red"},
    {"wind": 7, "colour": "red"},
    {"wind": 0.1, "colour": "green"},
    {"wind": 0.1, "colour": ["red"]},
]


@pytest.mark.parametrize("value", DAMAGED)
def test_damaged_settings_of_a_domain(shell: Shell, carts: Path, value: Any) -> None:
    edited(carts / "run", domain_settings=value)
    for words in ((TRAIN, "--resume", "run"), (EVALUATE, "run")):
        message = shell.refuses(*words, *CART)
        assert "is unknown or missing" in message or "wind is" in message or "colour is" in message


def test_damaged_settings_of_a_tabletop(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    right = about(run)["domain_settings"]
    for value, says in (
        (None, "is unknown or missing"),
        ({**right, "colour": "red"}, "'colour' is unknown or missing"),
        ({**right, "position_noise": -1}, "position_noise is -1; give a number from 0 to 10"),
        ({**right, "position_noise": 10**400}, "give a number from 0 to 10"),
        ({**right, "percept": "nose"}, "percept is 'nose'; use one of auto, box, yaw"),
        ({**right, "robot": 3}, "robot is 3; give a text"),
    ):
        edited(run, domain_settings=value)
        for words in ((TRAIN, "--resume", run), (EVALUATE, run), (VIEW, run)):
            assert says in shell.refuses(*words)


@pytest.mark.parametrize("domain", [3, None, "", "fly", "tabletop:x", ":", "a:b:c", "gymnasium"])
def test_a_damaged_name_of_a_domain(
    shell: Shell, trained: Trained, tmp_path: Path, domain: object
) -> None:
    run = copied(trained, tmp_path / "run")
    edited(run, {"domain": domain})
    for words in ((TRAIN, "--resume", run), (EVALUATE, run), (VIEW, run)):
        message = shell.refuses(*words)
        assert "domain" in message or "setting" in message


OTHERS = """
from cgtorch import Action, Domain, DomainSettings, option
from cgtorch.graphs import ContinuousNN, Step
from dataclasses import dataclass
from own_cart import Cart

@dataclass(frozen=True)
class Seeded(DomainSettings):
    seed: int = option(3, "A seed.")

@dataclass(frozen=True)
class Timed(DomainSettings):
    minutes: float = option(3.0, "Some minutes.")

@dataclass(frozen=True)
class Staged(DomainSettings):
    stage: str = option("x", "A stage.")

class SeededCart(Cart):
    settings_type = Seeded

class TimedCart(Cart):
    settings_type = Timed

class StagedCart(Cart):
    settings_type = Staged

class Broken(Cart):
    def __init__(self, settings=None):
        raise ValueError("no cart today")

class Incomplete(Domain):
    percept = ()

class Still(Cart):
    def draw(self, kind, count, generator):
        return None

class Crab(Action):
    outcomes = ("done",)
    num_parameters = 3

    def forward(self, lanes, parameters, environment):
        return lanes, parameters.view(-1, 2).long()[:, 0]

class Crabs(Cart):
    def actions(self):
        return super().actions().extended(["Crab"], [Crab()])

class Narrow(Cart):
    def actions(self):
        return super().actions().extended(["Half"], [Step(9)])

class Sighted(Cart):
    def actions(self):
        return super().actions().extended(["See"], [ContinuousNN(6, outputs=1)])

@dataclass(frozen=True)
class Hasty(DomainSettings):
    run_defaults = {"max_transition": 30}

class Mistyped(Cart):
    settings_type = Hasty

class Declared(Domain):
    settings: Hasty

class Bare(DomainSettings):
    gusts: float = option(0.1, "Gusts.")

class Undecorated(Cart):
    settings_type = Bare

class Unsettled(Cart):
    settings_type = dict

nothing = 3
"""
BROKEN = """
from dataclasses import dataclass
from cgtorch import DomainSettings

@dataclass
class Thawed(DomainSettings):
    pass
"""


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        (
            "fly",
            "unknown domain 'fly'; known are gymnasium, gymnasium-robotics, metaworld, tabletop, "
            "or give 'package.module",
        ),
        ("", "unknown domain ''"),
        ("no_such_package:Fly", "cannot import domain 'no_such_package:Fly'"),
        ("own_cart:Fly", "cannot import domain 'own_cart:Fly'"),
        ("json:loads", "give a subclass of cgtorch.Domain"),
        ("others:nothing", "domain 'others:nothing' is 3; give a subclass of cgtorch.Domain"),
        ("cgtorch.tabletop.actions:Grasp", "give a subclass of cgtorch.Domain"),
        ("others:SeededCart", "has a setting 'seed', which every run has; rename it"),
        ("others:TimedCart", "has a setting 'minutes', which every run has; rename it"),
        ("others:StagedCart", "has a setting 'stage', which every run has; rename it"),
        ("others:Broken", "cannot be made as Broken(settings) (ValueError: no cart today)"),
        ("others:Incomplete", "class Incomplete lacks draw and world; implement it"),
        ("others:Still", "Still.draw returned"),
        ("others:Crabs", "action 'Crab'"),
        ("others:Narrow", "action 'Half' sends 9 numbers as a control, of which the domain has 1"),
        ("others:Sighted", "action 'See' reads 6 numbers, and a percept has 2; make it for these"),
        ("others:Mistyped", "has run_defaults for 'max_transition'; name 'max_transitions'"),
        ("others:Declared", "declares its settings but has no settings_type; give it both"),
        ("others:Undecorated", "settings_type <class 'others.Bare'>; give a subclass of cgtorch."),
        ("others:Unsettled", "settings_type <class 'dict'>; give a subclass of cgtorch.Domain"),
        ("broken:Thawed", "from a frozen one) in line 5 of broken.py; correct that first"),
        ("gymnasium", "names no environment; give gymnasium:NAME"),
        (":", "domain ':'"),
        ("..:x", "domain '..:x'"),
    ],
)
def test_what_is_no_domain(shell: Shell, tmp_path: Path, spec: str, says: str) -> None:
    (tmp_path / "own_cart.py").write_text(EXAMPLE)
    (tmp_path / "others.py").write_text(OTHERS)
    (tmp_path / "broken.py").write_text(BROKEN)
    message = shell.refuses(TRAIN, "--domain", spec, "--run-dir", "run")
    assert says in message
    assert not (tmp_path / "run").exists()


LATE = """
from own_cart import Cart, Rail

class Fragile(Rail):
    def next_state(self, state, control, scenario):
        if (state[:, 0].abs() > 2.9).any():
            raise {}("off the rail")
        return super().next_state(state, control, scenario)

class Glass(Cart):
    def world(self, scenarios):
        return Fragile(scenarios)
"""


@pytest.mark.parametrize(
    "error", ["IndexError", pytest.param("SystemExit", marks=pytest.mark.hostile)]
)
def test_an_error_in_a_domain_is_one_line_whenever_it_happens(tmp_path: Path, error: str) -> None:
    (tmp_path / "own_cart.py").write_text(EXAMPLE)
    (tmp_path / "late.py").write_text(LATE.format(error))
    ended = in_a_shell(TRAIN, "--domain", "late:Glass", "--run-dir", "run", folder=tmp_path)
    assert ended.code == 1
    assert "Traceback" not in ended.err
    last = ended.err.strip().splitlines()[-1]
    assert last.startswith(f"cgtorch-train: {error}: off the rail in line 7 of late.py; ")
    assert last.endswith("continue with cgtorch-train --resume run --domain late:Glass")


LEAKY = """
from own_cart import Cart, Rail

class Leaky(Rail):
    def perceived(self, state, scenario):
        return state / ((state[:, :1] - 1.5).abs() > 2e-3)

class Leak(Cart):
    def world(self, scenarios):
        return Leaky(scenarios)
"""


def test_what_a_domain_shows_is_told_with_how_to_go_on(tmp_path: Path) -> None:
    (tmp_path / "own_cart.py").write_text(EXAMPLE)
    (tmp_path / "leaky.py").write_text(LEAKY)
    ended = in_a_shell(TRAIN, "--domain", "leaky:Leak", "--run-dir", "run", folder=tmp_path)
    assert ended.code == 2
    last = ended.err.strip().splitlines()[-1]
    assert "Leaky showed number 1 of its percept as " in last
    assert last.endswith("continue with cgtorch-train --resume run --domain leaky:Leak")


def test_a_skill_file_for_no_domain(shell: Shell, trained: Trained) -> None:
    path = trained.folder / "S0" / "skill.json"
    for words in ((EVALUATE, path), (EXPORT, path, "--format", "json", "--output", "x")):
        assert "unknown domain 'fly'" in shell.refuses(*words, "--domain", "fly")
        message = shell.refuses(*words, "--domain", "json:loads")
        assert "give a subclass of cgtorch.Domain" in message


@pytest.mark.parametrize(
    ("domain", "has", "lacks"),
    [
        (
            "tabletop",
            ["--position-noise", "--percept", "--robot", "--noise", "[default: 0]", "perimeter"],
            ["--wind", "This domain has", "[default: 77]"],
        ),
        (
            "own_cart:Cart",
            ["--wind", "--colour", "[default: 0.25]", "[default: 77]", "has calm, windy."],
            ["--robot", "perimeter"],
        ),
    ],
)
def test_help_has_the_settings_of_the_domain(
    shell: Shell, tmp_path: Path, domain: str, has: list[str], lacks: list[str]
) -> None:
    (tmp_path / "own_cart.py").write_text(OWN_CART)
    ended = shell.does(TRAIN, "--domain", domain, "--help")
    text = " ".join(ended.out.split())
    assert all(word in text for word in [*has, "--seed", "--target"])
    options = ended.out.partition("Examples:")[0]
    assert not any(word in options for word in lacks)


def test_help_of_a_domain_that_computes_its_kinds(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "own_cart.py").write_text(EXAMPLE)
    (tmp_path / "computed.py").write_text(
        "from own_cart import Cart\n\nclass Many(Cart):\n    kinds = property(lambda _: ('a',))\n"
    )
    assert "This domain has" not in shell.does(TRAIN, "--domain", "computed:Many", "--help").out
