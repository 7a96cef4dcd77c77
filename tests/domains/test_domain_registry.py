"""Domains by name: those of the library, those of installed packages, and one's own."""

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from rail import Cart, RailSettings

import cgtorch.domains.registry as registry
from cgtorch.domains.domain import Domain
from cgtorch.domains.registry import (
    check_options,
    domain_class,
    is_code,
    known_names,
    make_domain,
    settings_class,
    spec_of,
    with_name,
)
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


def test_a_domain_without_settings_of_its_own_has_the_empty_ones() -> None:
    assert Unfinished.settings_type is DomainSettings
