"""How Gymnasium environments are made: modules, keyword arguments and wrappers of the user's."""

import gc
import json
import os
import pickle
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
import torch
from support import seeded

from cgtorch.domains.domain import most_lanes
from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_episodes import _close
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import VectorSteps
from cgtorch.domains.registry import full_name, is_code, make_domain, spec_of, with_name
from cgtorch.domains.settings import from_plain, to_plain
from cgtorch.ground.environment import start_lanes
from cgtorch.ground.errors import DomainError, SettingsError
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import planned_run, read_run, write_run

gymnasium = pytest.importorskip("gymnasium")
from tiny_worlds import GOAL, Goal  # noqa: E402

SLOWER, DOUBLED = "tiny_worlds:slower", "tiny_worlds:doubled"


def domain_of(name: str = GOAL, **settings: Any) -> Gymnasium:
    settings = {"target_return": -1.0, **settings}
    made = make_domain(f"gymnasium:{name}", GymnasiumSettings(**settings))
    assert isinstance(made, Gymnasium)
    return made


def way_of(domain: Gymnasium) -> tuple[torch.Tensor, torch.Tensor]:
    """How far a step moves the point of each lane, and the rewards of it."""
    world: Any = domain.world(domain.draw("starts", 3, seeded(0)))
    lanes = start_lanes(world, torch.arange(3), world.control_size, 0)
    after, _ = world.step(lanes, torch.full((3, 2), 0.5))
    names = [field.name for field in domain.percept]
    column = names.index("achieved_goal 1")
    scale = domain.known.scaling.scale[column]
    return (after.percept - lanes.percept)[:, column] * scale, world.returns(after)


def test_the_name_imports_the_module() -> None:
    code = (
        "from cgtorch.domains.registry import make_domain, settings_class as kind; "
        "import sys; name = 'gymnasium:tiny_worlds:Tiny/Goal-v0'; settings = kind(name)(); "
        "print('tiny_worlds' in sys.modules); "
        "print(len(make_domain(name, settings).percept), 'tiny_worlds' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parent,
    )
    assert done.stdout.split() == ["False", "6", "True"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "",
            r"module 'own_module' was imported and does not register 'Own-v0'; .*gymnasium\.reg",
        ),
        ("import gym", r"No module named 'gym'.*; port it from gym to its successor"),
        (
            "import no_such",
            r"No module named 'no_such'\) in line 1 of own_module.py; is it spelt right, and",
        ),
    ],
)
def test_a_module_that_gives_no_environment_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "own_module.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_module", raising=False)
    with pytest.raises(DomainError, match=message):
        domain_of("own_module:Own-v0")


def test_a_module_that_is_not_found_is_looked_for_here() -> None:
    with pytest.raises(DomainError, match=r"given \(module:ENV_ID\), .* on PYTHONPATH or"):
        domain_of("no_such_module:Own-v0")


def test_what_takes_long_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    told = list[str]()
    monkeypatch.setattr("test_gymnasium_made.told", told, raising=False)
    (tmp_path / "slow_module.py").write_text(
        "import test_gymnasium_made as t\nfrom cgtorch.domains.surroundings import surroundings\n"
        "t.told.append(surroundings.unreturned(0))"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(DomainError, match="does not register 'Own-v0'"):
        domain_of("slow_module:Own-v0")
    assert told[0].startswith("the import of module 'slow_module' has not returned for 0 s")


def test_it_is_told_how_long_calls_took() -> None:
    domain = domain_of()
    assert domain.pace() == ""
    domain.episodes.explored(2, 3)
    number = r"[\d.e-]+ s in the mean, [\d.e-]+ s at most"
    said = rf"in environment '{GOAL}', a reset took {number} and a step took {number}"
    assert re.fullmatch(said, domain.pace())


def test_keyword_arguments_are_those_of_the_environment() -> None:
    slow, fast = domain_of(env={"speed": 0.1}), domain_of(env=("speed=0.4",))
    assert torch.allclose(way_of(fast)[0], 4 * way_of(slow)[0], atol=1e-5)
    with pytest.raises(DomainError, match=r"Gymnasium cannot .*unexpected keyword.*'sped'.*--env"):
        domain_of(env={"sped": 1})
    with pytest.raises(DomainError, match=r"cannot make environment 'no_such:A-v0'.*no_such"):
        domain_of("no_such:A-v0")


class Rare(Goal):
    """One of which few may exist at once, with a thread that ends when it is closed."""

    places, open, closed = 9, 0, 0

    def __init__(self) -> None:
        if Rare.open >= self.places:
            raise RuntimeError("the licence is in use")
        Rare.open += 1
        self.over = threading.Event()
        super().__init__()

    def close(self) -> None:
        Rare.open -= 1
        Rare.closed += 1
        raise OSError("there is no window any more")


gymnasium.register("Tiny/Rare-v0", Rare, max_episode_steps=5)


@pytest.mark.parametrize("places", [1, 2])
def test_an_environment_may_exist_only_a_few_times(
    monkeypatch: pytest.MonkeyPatch, places: int
) -> None:
    monkeypatch.setattr(Rare, "places", places)
    few, many = domain_of("Tiny/Rare-v0"), domain_of()
    assert torch.equal(way_of(few)[1], way_of(many)[1])
    assert most_lanes(few) == places
    said = rf"Only {places} at once .* the licence is in use"
    assert re.search(said, " ".join(few.pictures(few).remarks()))
    monkeypatch.setattr(Rare, "places", 0)
    with pytest.raises(DomainError, match=r"the licence is in use\) in line \d+.*; correct it the"):
        domain_of("Tiny/Rare-v0")
    del few
    gc.collect()
    assert Rare.open == 0


def test_environments_are_closed_before_their_threads_are_waited_for() -> None:
    """One that is no daemon would keep the program from ending."""
    code = """
import threading, tiny_worlds
from cgtorch.domains.registry import make_domain, settings_class as kind

def init(self):
    own(self)
    self.over = threading.Event()
    threading.Thread(target=self.over.wait).start()

own, tiny_worlds.Goal.__init__ = tiny_worlds.Goal.__init__, init
tiny_worlds.Goal.close = lambda self: self.over.set()
name = "gymnasium:tiny_worlds:Tiny/Goal-v0"
domain = make_domain(name, kind(name)())
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parent, timeout=60)


@pytest.mark.parametrize(
    ("raised", "closed"), [(SystemExit(5), 2), (KeyboardInterrupt(), 1), (OSError(), 2)]
)
def test_what_closing_raises_ends_nothing_else(raised: BaseException, closed: int) -> None:
    """Only a user who interrupts it ends all closing."""
    calls = list[int]()

    class Loud:
        def close(self) -> None:
            calls.append(1)
            raise raised

    _close([(os.getpid(), Loud()), (os.getpid(), Loud())])
    assert len(calls) == closed


def test_values_are_json_or_python_or_texts() -> None:
    given = {
        "a": 1, "b": True, "c": None, "d": [1, 2.5], "e": {"x": (1, 2)}, "f": "4x4", "g": "1",
        "h": "true", "i": 1e-3, "j": "a=b", "k": "", "l": "None",
    }  # fmt: skip
    settings = GymnasiumSettings(env=given)
    assert settings.keywords == given
    stored = json.loads(json.dumps(to_plain(settings)))
    assert from_plain(GymnasiumSettings, stored) == settings
    words = ("continuous=true", "gravity=-3.5", "map_name=8x8", "size=(3, 4)", "wind=None")
    assert GymnasiumSettings(env=words).keywords == {
        "continuous": True, "gravity": -3.5, "map_name": "8x8", "size": (3, 4), "wind": None,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"env": ("speed",)}, "env is 'speed'; give NAME=VALUE, such as"),
        ({"env": ("a b=3",)}, "env is 'a b=3'; give NAME=VALUE"),
        ({"env": {"speed": object()}}, "env has speed <object .*, which cannot be stored in a run"),
        ({"env": "speed=3"}, "env are 'speed=3'; give names in a tuple"),
        ({"wrappers": ("slower",)}, "wrappers has 'slower'; give package.module:function"),
    ],
)
def test_settings_that_cannot_work(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        GymnasiumSettings(**settings)


def test_wrappers_are_applied_in_order_and_in_other_processes() -> None:
    plain, slow, both = domain_of(), domain_of(wrappers=(SLOWER,)), domain_of(f"{GOAL}+{DOUBLED}")
    assert torch.allclose(way_of(plain)[0], 2 * way_of(slow)[0], atol=1e-5)
    assert torch.allclose(2 * way_of(plain)[1], way_of(both)[1])
    assert both.settings.wrappers == (DOUBLED,)
    again = pickle.loads(pickle.dumps(both.episodes))  # noqa: S301  our own bytes
    assert again.explored(1, 5).rewards == pytest.approx(both.episodes.explored(1, 5).rewards)
    # A time limit that a wrapper may depend on stays inside.
    assert way_of(domain_of("tiny_worlds:Tiny/Goal-v0", wrappers=(SLOWER, DOUBLED)))[1].sum() < 0


@pytest.mark.parametrize(
    ("wrapper", "message"),
    [
        ("tiny_worlds:lost", "wrapper 'tiny_worlds:lost' returned None; return an environment"),
        ("tiny_worlds:breaking", r"'tiny_worlds:breaking' fails .*no such sensor\) in line .*tiny"),
        ("tiny_worlds:NOTHING", "wrapper 'tiny_worlds:NOTHING' is 3; give a function"),
        ("tiny_worlds:fast", "cannot import wrapper 'tiny_worlds:fast' .*AttributeError"),
        ("no_such:fast", "cannot import wrapper 'no_such:fast' .*is it spelt right"),
    ],
)
def test_wrappers_that_cannot_work(wrapper: str, message: str) -> None:
    with pytest.raises(DomainError, match=message):
        domain_of(wrappers=(wrapper,))


def test_a_name_has_all_code_that_is_imported() -> None:
    assert not is_code("gymnasium:CartPole-v1")
    assert is_code("gymnasium:tiny_worlds:Tiny/Goal-v0")
    assert is_code(f"gymnasium:CartPole-v1+{SLOWER}")
    name = f"gymnasium:{GOAL}+{SLOWER}+{DOUBLED}"
    settings: Any = with_name(name, GymnasiumSettings())
    assert (settings.environment, settings.wrappers) == (GOAL, (SLOWER, DOUBLED))
    assert full_name(f"gymnasium:{GOAL}", settings) == name
    assert full_name("tabletop", GymnasiumSettings()) == "tabletop"
    assert spec_of(domain_of(wrappers=(SLOWER,)))[0] == f"gymnasium:{GOAL}+{SLOWER}"
    with pytest.raises(DomainError, match="names other wrappers than tiny_worlds:slower; give the"):
        with_name(f"gymnasium:{GOAL}+{DOUBLED}", GymnasiumSettings(wrappers=(SLOWER,)))
    for wrong in ("a:b:c", "a;b:C", "C+d e:f"):
        with pytest.raises((DomainError, SettingsError)):
            with_name(f"gymnasium:{wrong}", GymnasiumSettings())


@pytest.mark.parametrize("name", [f"gymnasium:{GOAL}", f"gymnasium:Pendulum-v1+{DOUBLED}"])
def test_code_is_not_imported_because_a_run_names_it(tmp_path: Path, name: str) -> None:
    settings = GymnasiumSettings(target_return=-1.0)
    write_run(planned_run(tmp_path / "run", RunSettings(domain=name), settings))
    with pytest.raises(
        DomainError, match=r"which is code of its own; if you trust it.*--domain gy"
    ):
        read_run(tmp_path / "run")
    assert read_run(tmp_path / "run", domain=name).settings.domain == name
    with pytest.raises(DomainError, match="not 'gymnasium:Tiny/Goal-v0'; give that"):
        read_run(tmp_path / "run", domain="gymnasium:Tiny/Goal-v0")


@pytest.mark.parametrize("hidden", [{"environment": GOAL}, {"wrappers": [DOUBLED]}])
def test_settings_cannot_hide_code(tmp_path: Path, hidden: dict[str, Any]) -> None:
    settings = with_name("gymnasium:Pendulum-v1", GymnasiumSettings(target_return=-1.0))
    run = RunSettings(domain="gymnasium:Pendulum-v1")
    write_run(planned_run(tmp_path / "run", run, settings))
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    about["domain_settings"] |= hidden
    (tmp_path / "run" / "run.json").write_text(json.dumps(about))
    with pytest.raises(DomainError, match=r"has settings of 'gymnasium:.*; restore its run.json"):
        read_run(tmp_path / "run")


def test_a_run_of_before_these_settings_is_read(tmp_path: Path) -> None:
    run = RunSettings(domain="gymnasium:Acrobot-v1")
    write_run(planned_run(tmp_path / "run", run, GymnasiumSettings("Acrobot-v1")))
    path, stored = tmp_path / "run" / "run.json", tmp_path / "run" / "gymnasium.json"
    about = json.loads(path.read_text())
    for name in ("env", "percepts", "success", "success_at", "wrappers", "reward", "hidden"):
        del about["domain_settings"][name]
    path.write_text(json.dumps(about))
    known = json.loads(stored.read_text())
    del known["remark"]
    stored.write_text(json.dumps(known))
    assert read_run(tmp_path / "run").domain.settings == GymnasiumSettings("Acrobot-v1")


def test_a_name_without_its_version_has_no_vectorised_environment() -> None:
    with pytest.raises(LookupError, match=r"^CartPole has no vectorised environment"):
        VectorSteps("CartPole")
