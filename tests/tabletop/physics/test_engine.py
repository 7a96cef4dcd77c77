"""Without MuJoCo there is one error that says how to install it, before anything begins."""

import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.physics import engine
from cgtorch.tabletop.settings import TabletopSettings


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"pip install 'cgtorch\[physics\]'"):
        Tabletop(TabletopSettings(world="mujoco"))
    Tabletop(TabletopSettings())  # needs none


def test_worlds_and_measures_by_name() -> None:
    domain = Tabletop()
    assert not domain.other_measures()
    strict = domain.in_world("mujoco")
    assert strict.settings.world == "mujoco"
    ((name, lifted),) = strict.other_measures().items()
    assert "lifted" in name
    assert lifted.settings.touch == "allowed"
    assert lifted.physics is strict.physics is domain.physics, "they share what they know"
    with pytest.raises(SettingsError, match="use one of kinematic, mujoco"):
        domain.in_world("moon")
