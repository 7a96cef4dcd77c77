"""Domains by name: those of the library, those of installed packages, and one's own."""

import subprocess
import sys
from dataclasses import field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from driven_cart import CartDriver
from rail import Cart, RailSettings

import cgtorch.domains.registry as registry
from cgtorch.domains.domain import Domain
from cgtorch.domains.registry import (
    check_name,
    check_options,
    domain_class,
    driver_of,
    full_name,
    is_code,
    known_names,
    make_domain,
    make_driver,
    settings_class,
    spec_of,
    with_name,
)
from cgtorch.domains.robot import RobotDriver
from cgtorch.domains.settings import DomainSettings
from cgtorch.ground.errors import DomainError, SettingsError
from cgtorch.runs.settings import NAMES
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.settings import TabletopSettings


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if an installed package declared the cart."""
    declared = EntryPoint("cart", "rail:Cart", registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [declared])


def refused(call: Any, *given: Any) -> str:
    with pytest.raises(DomainError) as caught:
        call(*given)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_tabletop_is_known_by_its_name() -> None:
    assert domain_class("tabletop") is Tabletop
    assert settings_class("tabletop") is TabletopSettings
    assert {"tabletop", "gymnasium"} <= set(known_names())


def test_settings_are_found_without_torch() -> None:
    code = (
        "import sys; from cgtorch.domains.registry import settings_class; "
        "print(*(settings_class(n).__name__ for n in ('tabletop', 'gymnasium:A-v1'))); "
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["TabletopSettings", "GymnasiumSettings", "False"]


@pytest.mark.parametrize("given", [3, None, int, RailSettings()])
def test_other_objects_are_no_domains(given: Any) -> None:
    said = "; give a name, a Domain or RobotDriver, or a class of one"
    assert refused(spec_of, given).endswith(said)


def test_settings_that_are_only_declared_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Cart, "settings_type", DomainSettings)
    monkeypatch.setitem(Cart.__annotations__, "settings", RailSettings)
    assert "declares its settings but has no settings_type" in refused(settings_class, "rail:Cart")


def test_a_class_of_ones_own_is_code() -> None:
    assert domain_class("rail:Cart") is Cart
    assert settings_class("rail:Cart") is RailSettings
    assert is_code("rail:Cart")
    assert not any(map(is_code, ("tabletop", "gymnasium:CartPole-v1", "cart")))


@pytest.mark.usefixtures("installed")
def test_an_installed_domain_is_known_by_its_name() -> None:
    assert {"cart", "gymnasium", "metaworld", "tabletop"} < set(known_names())
    assert domain_class("cart") is Cart
    assert make_domain("cart").settings == RailSettings()
    assert "cart, gymnasium, gymnasium-robotics, metaworld, tabletop" in refused(
        domain_class, "carts"
    )


def test_a_domain_is_made_with_its_settings() -> None:
    made: Any = make_domain("rail:Cart", RailSettings(wind=0.1))
    assert isinstance(made, Cart)
    assert made.settings.wind == 0.1
    assert make_domain("rail:Cart").settings == RailSettings()


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("shelf", "unknown domain 'shelf'; known are .*gymnasium, .*tabletop, or give 'package."),
        ("", "unknown domain ''"),
        ("nowhere:Cart", "cannot import domain 'nowhere:Cart' .*ModuleNotFoundError.*spelt right"),
        ("rail:Train", "cannot import domain 'rail:Train' .AttributeError"),
        ("rail:", "cannot import domain 'rail:'|domain 'rail:' is"),
        ("rail:Rail", "domain 'rail:Rail' is <class 'rail.Rail'>; give a subclass of cgtorch.Do"),
        ("rail:END", "domain 'rail:END' is 3.0; give a subclass"),
    ],
)
def test_what_is_no_domain_is_refused(spec: str, message: str) -> None:
    with pytest.raises(DomainError, match=message):
        domain_class(spec)
    refused(domain_class, spec)


def test_a_module_that_breaks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_rail.py").write_text("raise ValueError('no rail\\nat all')\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert (
        "(ValueError: no rail at all) in line 1 of broken_rail.py; correct that first"
        in refused(domain_class, "broken_rail:Cart")
    )


def test_a_folder_is_no_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder_of_a_run").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    message = refused(domain_class, "folder_of_a_run:Cart")
    assert message.endswith("is its file in this folder, on PYTHONPATH or installed?")


class Fussy(Cart):
    """One whose constructor wants more."""

    def __init__(self, settings: Any, more: int) -> None:
        super().__init__(settings)


class Picky(Cart):
    """One whose constructor refuses its settings."""

    def __init__(self, settings: Any) -> None:
        raise SettingsError("wind is too weak")


class Unfinished(Domain[Any]):
    """One that cannot draw."""

    percept = control = Cart.percept


def test_a_domain_that_cannot_be_made_is_named() -> None:
    message = refused(make_domain, f"{__name__}:Fussy")
    assert "cannot be made as Fussy(settings) (TypeError: " in message
    assert message.endswith("give it a constructor that needs no other arguments")
    message = refused(make_domain, f"{__name__}:Unfinished")
    assert "class Unfinished lacks draw and world; implement it" in message
    with pytest.raises(SettingsError, match="wind is too weak"):
        make_domain(f"{__name__}:Picky")


def test_the_name_of_a_gymnasium_domain_says_which_environment() -> None:
    settings: Any = settings_class("gymnasium:Own/Cart-v1")()
    found: Any = with_name("gymnasium:Own/Cart-v1", settings)
    assert found.environment == "Own/Cart-v1"
    assert type(found) is type(settings)
    own = RailSettings()
    assert with_name("rail:Cart", own) is own
    for spec in ("gymnasium", "gymnasium:", "gymnasium:a b"):
        assert "names no environment; give gymnasium:NAME" in refused(with_name, spec, settings)


def test_no_setting_of_a_domain_is_called_as_one_of_every_run() -> None:
    for spec in ("tabletop", "gymnasium", "rail:Cart"):
        check_options(spec, NAMES)
    message = refused(check_options, "rail:Cart", ("seed", "wind"))
    assert message == "domain 'rail:Cart' has a setting 'wind', which every run has; rename it"


def test_a_default_for_no_setting_of_a_run_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, said in (("populations", "'population'"), ("xyz", "a setting of a run")):
        monkeypatch.setattr(RailSettings, "run_defaults", {"population": 7, name: 1})
        message = refused(check_options, "rail:Cart", NAMES)
        assert message.startswith(f"domain 'rail:Cart' has run_defaults for '{name}'; name {said}")


def test_a_domain_that_says_nothing_of_itself_has_what_is_usual() -> None:
    assert Unfinished.settings_type is DomainSettings
    assert Unfinished.target_return == 0, "as a return above 0 is a gain"
    assert Unfinished.repeats


def test_objects_and_classes_have_the_names_by_which_they_are_made_again() -> None:
    class Own(Cart):
        """One that nobody can import."""

    assert spec_of("anything") == ("anything", None)
    assert spec_of(Tabletop) == ("tabletop", None)
    assert spec_of(Cart) == ("rail:Cart", None)
    assert spec_of(CartDriver) == ("driven_cart:CartDriver", None)
    made = Cart()
    assert spec_of(made) == ("rail:Cart", made)
    name, found = spec_of(Own)
    assert name.endswith("<locals>.Own")
    assert isinstance(found, Own)
    pytest.importorskip("gymnasium")
    cart = make_domain("gymnasium:CartPole-v1")
    assert spec_of(cart) == ("gymnasium:CartPole-v1", cart)
    assert spec_of(type(cart)) == ("gymnasium", None)


def test_only_code_of_a_driver_is_a_driver() -> None:
    assert driver_of("driven_cart:CartDriver") == "driven_cart:CartDriver"
    assert [driver_of(spec) for spec in ("rail:Cart", "tabletop", "gymnasium:A-v1")] == [""] * 3
    assert isinstance(make_driver("driven_cart:CartDriver"), CartDriver)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("cart", "driver 'cart' is no name; give package.module:Class"),
        ("nowhere:Driver", "cannot import driver 'nowhere:Driver' (ModuleNotFoundError"),
        ("rail:Cart", "driver 'rail:Cart' is <class 'rail.Cart'>; give a subclass of RobotDriver"),
        ("rail:END", "driver 'rail:END' is 3.0; give a subclass of RobotDriver"),
        (f"{__name__}:Halted", "Halted' lacks perceive; implement it"),
        (f"{__name__}:Broken", "Broken' cannot be made (ValueError: no port) in line "),
    ],
)
def test_what_is_no_driver_is_refused(spec: str, message: str) -> None:
    assert message in refused(make_driver, spec)


class Halted(RobotDriver):
    """One that cannot even see."""


class Broken(CartDriver):
    """One without a robot."""

    def __init__(self) -> None:
        raise ValueError("no port")


def test_wrappers_and_rewards_are_named_once() -> None:
    settings: Any = settings_class("gymnasium")()
    spec = "gymnasium:a:Cart-v1+b:Wrap+reward=c:paid+d:Other"
    found: Any = with_name(spec, settings)
    assert (found.environment, found.wrappers, found.reward) == (
        "a:Cart-v1", ("b:Wrap", "d:Other"), "c:paid",
    )  # fmt: skip
    assert with_name(spec, found) == found
    kept: Any = with_name("gymnasium:a:Cart-v1", found)
    assert (kept.wrappers, kept.reward) == (found.wrappers, found.reward)
    message = refused(with_name, "gymnasium:Cart-v1+e:Wrap", found)
    assert message.endswith("names other wrappers than b:Wrap, d:Other; give them once")
    message = refused(with_name, "gymnasium:Cart-v1+reward=e:paid", found)
    assert message.endswith("names another reward than c:paid; give it once")
    arms: Any = settings_class("metaworld")()
    for spec in ("metaworld:reach-v3+b:Wrap", "metaworld:a/reach-v3"):
        assert "names no environment; give metaworld:NAME" in refused(with_name, spec, arms)


def test_a_run_has_the_settings_of_the_domain_that_it_names() -> None:
    settings = with_name("gymnasium:Cart-v1+b:Wrap", settings_class("gymnasium")())
    assert full_name("gymnasium:Cart-v1", settings) == "gymnasium:Cart-v1+b:Wrap"
    assert full_name("rail:Cart", RailSettings()) == "rail:Cart"
    check_name("gymnasium:Cart-v1+b:Wrap", settings)
    assert refused(check_name, "gymnasium:Cart-v1", settings) == (
        "a run about domain 'gymnasium:Cart-v1' has settings of 'gymnasium:Cart-v1+b:Wrap'; "
        "restore its run.json"
    )


def test_settings_that_are_no_frozen_dataclass_of_the_kind_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Plain(DomainSettings):
        """One that was not decorated."""

        wind: float = field(default=0.1)

    for found in (int, "RailSettings", Plain):
        monkeypatch.setattr(Cart, "settings_type", found)
        message = refused(settings_class, "rail:Cart")
        assert "; give a subclass of cgtorch.DomainSettings that is decorated" in message
