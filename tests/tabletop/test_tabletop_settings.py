"""Which settings of the tabletop cannot work, and which are fixed in a run."""

import math
import runpy
from dataclasses import fields

import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop import settings
from cgtorch.tabletop.settings import TabletopSettings


@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("noise", ("seeded", "fresh")),
        ("percept", ("auto", "box", "yaw")),
        ("world", ("kinematic", "mujoco")),
        ("touch", ("fails", "allowed")),
        ("grasp", ("way", "posture")),
        ("networks", ("auto", "percept", "edge")),
    ],
)
def test_words_are_among_the_choices(name: str, choices: tuple[str, ...]) -> None:
    for choice in choices:
        assert getattr(TabletopSettings(**{name: choice}), name) == choice  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match=f"{name} is 'other'.*{', '.join(choices)}"):
        TabletopSettings(**{name: "other"})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["position_noise", "heading_noise"])
def test_noise_is_neither_negative_nor_larger_than_a_room(name: str) -> None:
    for value in (0.0, 10.0):
        assert getattr(TabletopSettings(**{name: value}), name) == value  # type: ignore[arg-type]
    for value in (-1e-9, 10.1, math.nan):
        with pytest.raises(SettingsError, match=f"{name} is "):
            TabletopSettings(**{name: value})  # type: ignore[arg-type]


def test_runs_of_earlier_versions_have_what_these_did() -> None:
    """What a run.json does not say is what the library did before there was a choice."""
    anew = runpy.run_path(settings.__file__)["TabletopSettings"]  # as a process that begins does
    assert vars(anew()) == vars(TabletopSettings())
    assert anew().heading_noise == pytest.approx(math.radians(0.5))
    assert anew.usual_stage == "S2"
    told = {f.name: f.metadata for f in fields(anew)}
    assert told == {f.name: f.metadata for f in fields(TabletopSettings)}
    assert all(about["help"] and about["fixed"] and about["when"] for about in told.values())
    assert {name for name, about in told.items() if about["choices"]} == {
        "noise", "percept", "world", "touch", "grasp", "networks",
    }  # fmt: skip
    for name in ("position_noise", "heading_noise"):
        assert (told[name]["least"], told[name]["most"]) == (0, 10)
    before = {f.name: f.metadata.get("before") for f in fields(anew)}
    assert {name: value for name, value in before.items() if isinstance(value, str)} == {
        "noise": "seeded", "world": "kinematic", "touch": "fails", "grasp": "posture",
    }  # fmt: skip
